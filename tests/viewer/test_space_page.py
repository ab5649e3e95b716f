"""The scene and the 3-D view in headless Chromium, with WebGL by software."""

import asyncio

import pytest
from support.browser import PROGRAM, Browser

import etendue

pytestmark = [pytest.mark.slow, pytest.mark.skipif(PROGRAM is None, reason="no Chromium on this machine")]

WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
#: In the page: a section of the side bar by its heading, and the button with a text in it.
TOOLS = """
window.part = (title) => [...document.querySelectorAll('#sections details')]
  .find((d) => d.querySelector('summary').textContent.startsWith(title));
window.press = (title, text) => [...part(title).querySelectorAll('button')].find((b) => b.textContent === text).click();
"""
#: The number of different colours of the 3-D view.
COLOURS = """(() => {
  const gl = document.querySelector('.large canvas').getContext('webgl2');
  const pixels = new Uint8Array(4 * gl.drawingBufferWidth * gl.drawingBufferHeight);
  gl.readPixels(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return new Set(new Uint32Array(pixels.buffer)).size;
})()"""
PAINTED = "Number(document.querySelector('.large canvas')?.dataset.painted ?? 0)"


@pytest.mark.parametrize(("size", "touch"), [((1280, 800), False), ((390, 844), True)])
def test_the_scene_is_edited_and_drawn(size, touch, tmp_path):
    async def visit(viewer):
        async with Browser(*size, touch=touch, more=WEBGL) as tab:
            await tab.open(viewer.url)
            await tab.until("document.body.dataset.passes >= 2")
            await tab.value(TOOLS)

            # A value that is refused is told, and the field shows the old one again.
            field = "part('red diffuse').querySelector('input[type=text]')"
            await tab.until("Boolean(part('red diffuse'))")
            before = await tab.value(f"{field}.value")
            change = f"(v) => {{ const f = {field}; f.value = v; f.dispatchEvent(new Event('change')); }}"
            await tab.value(f"({change})('0.5 2 0.5')")
            await tab.until("document.querySelector('#messages p.error')?.textContent.includes('at most 1')")
            await tab.until(f"{field}.value === '{before}'")
            await tab.value(f"({change})('0.1 0.2 0.3')")
            await tab.until("part('Scene').querySelector('.list').textContent.includes('0.1 0.2 0.3')")
            await tab.value("press('Scene', 'Reset all')")
            await tab.until(f"{field}.value === '{before}'")

            # The 3-D view, by keyboard.
            await tab.value("press('3-D view', 'Open the 3-D view')")
            await tab.until(f"{PAINTED} > 0")
            assert await tab.value(COLOURS) > 20
            painted = await tab.value(PAINTED)
            await tab.press("ArrowLeft")
            await tab.until(f"{PAINTED} > {painted}")
            await tab.value("press('Paths', 'Trace')")
            await tab.until("part('Paths').textContent.includes('100 paths of path. Edges:')")
            await tab.value("press('Radiosity', 'Solve')")
            await tab.until("part('Radiosity').textContent.includes('bundles')")
            await tab.until("document.querySelector('.scale')?.textContent.includes('radiosity')")
            await tab.press("Enter")
            await tab.until("part('Radiosity').textContent.includes('area')")
            await tab.press("Escape")
            await tab.until("document.getElementById('large').hidden")
            assert await tab.value("document.documentElement.scrollWidth") <= size[0]
            assert not tab.errors

    with etendue.view("cornell-box", "path", size=(48, 36), spp=8, max_depth=3, folder=tmp_path) as viewer:
        asyncio.run(visit(viewer))


def test_rays_are_drawn_over_the_picture_and_follow_it(tmp_path):
    """Unfolding the section traces; so does every click, and another method."""
    lines = "document.querySelectorAll('#overlay g path').length"
    note = "part('Paths').querySelector('p').textContent"
    colours = "new Set([...document.querySelectorAll('#overlay g path')].map((p) => p.getAttribute('stroke')))"

    async def visit(viewer):
        async with Browser() as tab:
            await tab.open(viewer.url)
            await tab.until("document.body.dataset.passes >= 2")
            await tab.value(TOOLS)
            await tab.value("part('3-D view').open = part('Paths').open = true")
            await tab.until(f"{note}.endsWith(' …')")  # what is being done
            await tab.until(f"{note}.startsWith('100 paths of vcm. Edges:')")
            await tab.until(f"{lines} > 200")
            assert await tab.value(f"{colours}.size") >= 4  # camera and light paths, light points, connections, ...
            both = await tab.value(lines)
            await tab.value(
                "[...part('Paths').querySelectorAll('label')].find((l) => l.textContent === 'light paths').click()"
            )
            await tab.until(f"{lines} < {both} && {lines} > 100")
            drawn = "document.querySelector('#overlay g path').getAttribute('d')"
            first = await tab.value(drawn)
            await tab.value("document.getElementById('stage').focus()")
            await tab.press("ArrowLeft", hold=0.3)  # another camera, so another place is clicked
            await tab.press("KeyP")
            await tab.until(
                f"document.getElementById('picked').textContent.includes('material') && {drawn} !== '{first}'"
            )
            await tab.value("document.querySelector('select').value = 'path'")
            await tab.value("document.querySelector('select').dispatchEvent(new Event('change'))")
            await tab.until(f"{note}.startsWith('100 paths of path. Edges:')")
            await tab.value("press('Paths', 'Clear')")
            await tab.until(f"{lines} === 0")
            await tab.value("press('Paths', 'Trace'), press('Paths', 'Clear')")
            await asyncio.sleep(3.0)
            assert await tab.value(lines) == 0  # the answer came after they were cleared
            assert not tab.errors

    with etendue.view("cornell-box", "vcm", size=(48, 36), spp=64, folder=tmp_path) as viewer:
        asyncio.run(visit(viewer))
