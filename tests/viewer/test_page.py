"""The page in headless Chromium: it loads without an error, moves by keys, compares, tells errors, fits a phone."""

import asyncio
import json
import re

import pytest
from support.browser import PROGRAM, Browser
from support.viewing import proxied

import etendue

pytestmark = [pytest.mark.slow, pytest.mark.skipif(PROGRAM is None, reason="no Chromium on this machine")]

SHIFT = 8


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    with etendue.view("cornell-box", "path", size=(64, 48), spp=8, max_depth=4, folder=folder) as made:
        yield made


def browse(viewer, visit, *size, **options):
    async def go():
        async with Browser(*size, **options) as tab:
            await tab.open(viewer.url)
            await tab.until("document.body.dataset.ready === 'true'")
            await tab.until("document.getElementById('stage').dataset.frame > 0")
            await visit(tab)
            assert not tab.errors

    asyncio.run(go())


ORIGIN_FIELD = "document.querySelector('aside details:nth-of-type(4) input')"
ORIGIN = f"{ORIGIN_FIELD}.value"


def test_denoisers_of_components_are_chosen_in_the_page():
    """The rows of the components, and what the page asks for."""
    row = "[...document.querySelectorAll('aside label')].find((one) => one.firstChild.textContent === '{}')"
    pick = (
        "(({0}.querySelector('select').value = '{1}'), {0}.querySelector('select').dispatchEvent(new Event('change')))"
    )

    async def visit(tab):
        for label, name, denoise in (
            ("indirect", "gaussian", "indirect=gaussian:radius=5:strength=1"),
            ("Denoiser", "bilateral", "indirect=gaussian:radius=5:strength=1,bilateral"),
            ("direct", "none", "indirect=gaussian:radius=5:strength=1,bilateral,direct=none"),
            ("indirect", "", "bilateral,direct=none"),
            ("Denoiser", "", "direct=none"),
        ):
            place = row.format(label)
            await tab.until(f"Boolean({place})")
            await tab.value(pick.format(place, name))
            for _ in range(100):
                if made._session.show.denoise == denoise:
                    break
                await asyncio.sleep(0.1)
            assert made._session.show.denoise == denoise
            await asyncio.sleep(0.5)  # until the page has the new state

    with etendue.view("cornell-box", "path", size=(32, 24), spp=4, max_depth=3, for_denoising=True) as made:
        browse(made, visit)


def test_by_keyboard_alone(viewer):
    async def visit(tab):
        seen = []
        for _ in range(40):
            await tab.press("Tab")
            seen.append(await tab.value("document.activeElement.id || document.activeElement.tagName"))
            style = "getComputedStyle(document.activeElement)"
            # What has the focus shows it.
            ring = f"{style}.outlineStyle !== 'none' && parseFloat({style}.outlineWidth) > 0"
            assert seen[-1] == "BODY" or await tab.value(ring), await tab.value("document.activeElement.outerHTML")
        assert {"open-name", "stage", "pause", "again"} <= set(seen) and seen.count("SUMMARY") >= 4
        await tab.value("document.getElementById('stage').focus()")
        before = await tab.value(ORIGIN)
        await tab.press("ArrowLeft", hold=0.2)
        await tab.until(f"{ORIGIN} !== '{before}'")
        turned = await tab.value(ORIGIN)
        await tab.press("ArrowRight", modifiers=SHIFT, hold=0.1)
        await tab.until(f"{ORIGIN} !== '{turned}'")
        await tab.press("KeyV")
        await tab.until("document.querySelectorAll('aside details:nth-of-type(4) li').length === 1")
        await tab.press("KeyP")
        await tab.until("document.getElementById('picked').textContent.includes('material')")
        await tab.press("Space")
        await tab.until("document.getElementById('pause').getAttribute('aria-pressed') === 'true'")
        await tab.press("Space")
        await tab.press("Home")
        await tab.until(f"{ORIGIN} === '{before}'")

    browse(viewer, visit)


def test_a_drag_is_around_what_is_under_the_pointer(viewer):
    """The point where the drag began stays where it is in the picture."""

    async def visit(tab):
        await tab.value("document.getElementById('stage').focus()")
        await tab.press("KeyP")  # the line about it takes room from the picture
        await tab.until("document.getElementById('picked').textContent.includes('material')")
        box = await tab.value("JSON.stringify(document.getElementById('picture').getBoundingClientRect())")
        box = json.loads(box)
        x, y = box["left"] + 0.3 * box["width"], box["top"] + 0.8 * box["height"]

        async def mouse(kind, x, y):
            await tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

        async def material():
            before = await tab.value("document.getElementById('picked').textContent")
            await mouse("mousePressed", x, y)
            await mouse("mouseReleased", x, y)
            await tab.until(f"document.getElementById('picked').textContent !== {json.dumps(before)}")
            return await tab.value("document.getElementById('picked').textContent")

        first, before = await material(), await tab.value(ORIGIN)
        await mouse("mousePressed", x, y)
        for step in range(1, 11):
            await mouse("mouseMoved", x + step, y)
        await mouse("mouseReleased", x + 10, y)
        await tab.until(f"{ORIGIN} !== '{before}'")
        again = await material()
        places = [[float(v) for v in re.findall(r"at (\S+) (\S+) (\S+)", text)[0]] for text in (first, again)]
        assert places[1] == pytest.approx(places[0], abs=0.02)
        await tab.value("document.getElementById('stage').focus()")
        await tab.press("Home")
        await tab.until(f"{ORIGIN} === '{before}'")

    browse(viewer, visit)


def test_below_a_path_of_a_proxy(viewer):
    """The assets, the modules of panels and the WebSocket are found there."""
    prefix = "/user/me/proxy/8411"

    async def go():
        async with proxied(viewer._server.port, prefix) as port, Browser() as tab:
            await tab.open(f"http://localhost:{port}{prefix}/{viewer._server.token}/")
            await tab.until("document.body.dataset.ready === 'true'")
            await tab.until("document.getElementById('stage').dataset.frame > 0")
            assert not tab.errors

    asyncio.run(go())


def test_the_frame_of_a_notebook(tmp_path):
    """It fits the width; in a notebook that was saved, where the viewer is gone, there is a line instead of it."""
    saved = tmp_path / "saved.html"

    async def go():
        box = "document.querySelector('object').getBoundingClientRect().height"
        async with Browser(900, 900) as tab:
            with etendue.view("cornell-box", "path", size=(64, 48), spp=1) as made:
                saved.write_text(f"<!doctype html><meta charset=utf-8><body>{made._repr_html_()}", encoding="utf-8")
                await tab.open(saved.as_uri())
                await tab.until("document.querySelector('object')")
                await asyncio.to_thread(made.loaded)
                while not len(made._session.clients):  # the page within is there
                    await asyncio.sleep(0.1)
                assert await tab.value(box) == 720
                assert await tab.value("document.documentElement.scrollWidth <= innerWidth")
            await tab.open("about:blank")
            await tab.open(saved.as_uri())
            await tab.until(f"document.querySelector('object') && {box} < 100")
            assert await tab.value("document.querySelector('object p').getBoundingClientRect().height") > 0
            assert "This viewer has ended" in await tab.value("document.body.innerText")

    asyncio.run(asyncio.wait_for(go(), 120))


def test_that_the_session_has_ended_stays_when_a_late_picture_is_drawn():
    waiting = "document.getElementById('waiting')"

    async def go():
        async with Browser() as tab:
            with etendue.view("cornell-box", "path", size=(64, 48), max_depth=3) as made:
                await tab.open(made.url)
                await tab.until("document.getElementById('stage').dataset.frame > 1")
                # Decoding takes until the viewer is closed.
                await tab.value(
                    "window.decoding = 0; window.released = new Promise((r) => { window.release = r; });"
                    "const real = createImageBitmap; window.createImageBitmap = async (blob) => "
                    "{ decoding += 1; await released; return real(blob); }; 0"
                )
                await tab.until("decoding > 0")
                frame = await tab.value("document.getElementById('stage').dataset.frame")
            await tab.until(f"{waiting}.textContent.startsWith('The session has ended') && !{waiting}.hidden")
            await tab.value("release()")
            await tab.until(f"document.getElementById('stage').dataset.frame !== '{frame}'")
            await asyncio.sleep(0.3)
            assert await tab.value(f"!{waiting}.hidden && {waiting}.textContent.startsWith('The session has ended')")

    asyncio.run(asyncio.wait_for(go(), 120))


def test_every_control_has_a_label(viewer):
    async def visit(tab):
        await tab.value("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
        unnamed = await tab.value(
            "[...document.querySelectorAll('input, select, button, canvas[tabindex]')].filter((e) => e.offsetParent "
            "&& !(e.labels?.[0]?.textContent.trim() || e.getAttribute('aria-label') || e.textContent.trim()))"
            ".map((e) => e.outerHTML)"
        )
        assert unnamed == []

    browse(viewer, visit)


def test_errors_are_told_and_fields_show_what_holds(viewer):
    async def visit(tab):
        field = "document.querySelector('[id^=field-max_depth]')"
        await tab.until(f"{field} !== null")
        await tab.value(f"{field}.value = 'NaN'; {field}.dispatchEvent(new Event('change'))")
        await tab.until("document.querySelector('#messages .error')?.textContent.includes('whole number')")
        await tab.value("document.getElementById('open-name').value = 'nowhere'")
        await tab.value("document.getElementById('open').requestSubmit()")
        await tab.until("document.querySelector('#messages .error')?.textContent.includes('nowhere')")
        await tab.until("document.getElementById('waiting').hidden")
        assert await tab.value("document.getElementById('scene').textContent") == "cornell-box"

    browse(viewer, visit)


def test_what_is_being_typed_is_kept_when_the_state_changes(viewer):
    async def visit(tab):
        label = "[...document.querySelectorAll('label')].find((l) => l.textContent.startsWith('Seconds'))"
        fields = f"{label}.control", "document.querySelector('[id^=field-rr_depth]')"
        await tab.value("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
        for field, pressed in zip(fields, ("true", "false"), strict=True):
            await tab.value(f"{field}.focus(); {field}.select()")
            await tab.type("12")
            # Another page changes a setting, and pauses.
            await tab.value("document.getElementById('pause').click()")
            await tab.until(f"document.getElementById('pause').getAttribute('aria-pressed') === '{pressed}'")
            assert await tab.value(f"{field}.value") == "12"
            await tab.press("Enter")
            await tab.until(f"{field}.value === '12'")
        await asyncio.sleep(0.5)  # the session has the number; what it refuses changes nothing
        await tab.value(f"{fields[1]}.value = 'lots'; {fields[1]}.dispatchEvent(new Event('change'))")
        await tab.until("document.querySelector('#messages .error')?.textContent.includes(\"'lots'\")")
        await tab.until(f"{fields[1]}.value === '12'")
        await tab.value(f"{ORIGIN_FIELD}.value = 'here 0 1'; {ORIGIN_FIELD}.dispatchEvent(new Event('change'))")
        await tab.until("document.querySelector('#messages .error')?.textContent.includes(\"not 'here'\")")

    browse(viewer, visit)


def test_keys_by_what_they_print(viewer):
    """As on a German keyboard, which has + where the others have a bracket, and brackets with AltGr."""
    field_of_view = "document.querySelector('aside details:nth-of-type(4) label:nth-of-type(4) input').value"

    async def visit(tab):
        stage = "document.getElementById('stage')"
        for key, code, modifiers, changes, stays in (
            ("+", "BracketRight", "", ORIGIN, field_of_view),
            ("[", "Digit8", "altKey: true, ctrlKey: true, modifierAltGraph: true,", field_of_view, ORIGIN),
        ):
            before = await tab.value(changes), await tab.value(stays)
            event = f"{{key: '{key}', code: '{code}', {modifiers} bubbles: true}}"
            for kind in ("keydown", "keyup"):
                await tab.value(f"{stage}.dispatchEvent(new KeyboardEvent('{kind}', {event}))")
            await tab.until(f"{changes} !== '{before[0]}'")
            assert await tab.value(stays) == before[1]
        await tab.value(f"{stage}.focus()")
        await tab.press("Home")

    browse(viewer, visit)


def test_the_divider_between_two_pictures(viewer):
    async def visit(tab):
        select = (
            "[...document.querySelectorAll('label')].find((l) => l.textContent.startsWith('Second method')).control"
        )
        await tab.value(f"{select}.value = 'light'; {select}.dispatchEvent(new Event('change'))")
        await tab.until("document.getElementById('stage').dataset.bFrames > 0 && !document.getElementById('b').hidden")
        await tab.until("document.getElementById('progress').textContent.includes('relMSE')")
        await tab.value("document.getElementById('slider').focus()")
        before = await tab.value("document.getElementById('b').style.clipPath")
        await tab.press("ArrowRight")
        assert await tab.value("document.getElementById('b').style.clipPath") != before
        await tab.until("document.querySelectorAll('.plot path').length >= 1")
        await tab.value(f"{select}.value = ''; {select}.dispatchEvent(new Event('change'))")
        await tab.until("document.getElementById('b').hidden")

    browse(viewer, visit)


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_nothing_is_cut_off(viewer, width, height):
    async def visit(tab):
        await tab.value("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
        assert await tab.value("document.documentElement.scrollWidth <= innerWidth")
        wide = await tab.value(
            "[...document.querySelectorAll('aside *')].filter((e) => e.getBoundingClientRect().right > innerWidth + 1)"
            ".map((e) => e.outerHTML.slice(0, 80))"
        )
        assert wide == []
        assert await tab.value("document.getElementById('picture').getBoundingClientRect().width") > 0.6 * min(
            width, 900
        )

    browse(viewer, visit, width, height, touch=width < 500)
