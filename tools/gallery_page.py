"""The page of the gallery, docs/gallery.md, and its pictures: every bundled scene, and one of them by six methods.

python tools/gallery_page.py              writes the page, and the pictures that it lacks
python tools/gallery_page.py NAME...      renders the pictures of these scenes again; methods: those of the methods

Files of public scenes are looked for in the folder of the environment variable PUBLIC_SCENES.

The pictures are made by the commands of the page, as long as these last, and reduced to a width of 320 pixels.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from etendue import display, film
from etendue.scene import bundled

ROOT = Path(__file__).resolve().parents[1]
PAGE, PICTURES = ROOT / "docs" / "gallery.md", ROOT / "docs" / "images" / "gallery"
WIDTH, MOST_BYTES = 320, 40_000

#: The method of each scene; ``lines`` is that of radiosity.
METHODS = {
    "auto": "ajar flat street yard stage living-room bathroom hallway sitting-room",
    "path": "cornell-box car diffuse-office",
    "bpt": "gaps shutters cornell-glass skylight cornell-specular fog smoke",
    "guided": "glossy-office",
    "vcm": "caustics aquarium mirror-balls prism diamond",
    "sppm": "ring glass-of-water",
    "lines": "diffuse-room six-cubes room four-chairs nine-cubes test-one office bleed-box curved "
    "curved-colour three-lamps",
}
#: Those whose pictures are denoised; merging leaves blotches that a denoiser keeps.
DENOISED = ("auto", "path", "bpt", "guided")
DENOISE = "etendue develop picture.exr --denoise oidn -o picture.png"
COMPARED = ("path", "guided", "pssmlt", "bpt", "sppm", "vcm")
COMPARISON = f"etendue compare caustics {' '.join(f'-m {name}' for name in COMPARED)} --time 10 -o comparison"

HEAD = f"""# Gallery

Made by `tools/gallery_page.py`. Each picture was made by the command beside it, on two cores, and reduced to a width of
{WIDTH} pixels; `--time` is its time, and radiosity took 2 to 10 seconds. Those called *denoised* went
through the extra `denoise`:

    {DENOISE}

## What each method sees

The lamp of `caustics` is inside a bulb of glass, so that no point on it can be sampled from outside: all light of the
room is caustic. The same ten seconds and one exposure for all, by

    {COMPARISON}

"""

SEEN = """
`path` and `guided` find light only by camera paths that hit the lamp through the glass. `bpt` joins camera paths to
paths from the lamp, which gives the caustics on matt surfaces, but not what is seen of them in mirrors, through glass
or in water: no segment of such a path joins two matt points. `pssmlt` adds to a picture by `bpt` chains that go on from
the paths that have found light. `sppm` and `vcm` merge camera paths with light paths that end nearby, and see all of
it; `vcm` also connects, and weights both.
[Layers of each technique](components.md); [how to choose](choosing.md); [errors](speed.md).

"""

#: Public scenes by the names of their pictures: (title, author, where it is published, method, file, size).
PUBLIC = {
    "bidir-room": ("Bidir Room", "B. Bitterli, E. Veach", "Bitterli", "auto", "veach-bidir/scene.xml", "640x360"),
    "veach-mis": ("Veach, MIS", "B. Bitterli, E. Veach", "Bitterli", "path", "veach-mis/scene.xml", "640x360"),
    "water-caustic": ("Water Caustic", "Benedikt Bitterli", "Bitterli", "vcm", "water-caustic/scene.xml", "512x512"),
    "grey-white-room": ("The Grey & White Room", "Wig42", "Bitterli", "auto", "grey-white-room/scene.xml", "640x360"),
    "staircase": ("The Wooden Staircase", "Wig42", "Bitterli", "path", "wooden-staircase/scene.xml", "360x640"),
    "cornell": ("Cornell Box", "Benedikt Bitterli", "Bitterli", "path", "cornell-box/scene.xml", "512x512"),
    "torus": ("Torus", "Olesya Jakob", "Mitsuba", "vcm", "torus/scene.xml", "640x480"),
    "cbox": ("Cornell box with two spheres", "the authors of Mitsuba 3", "tutorials", "bpt", "cbox.xml", "512x512"),
}
LINKS = """
[Bitterli]: https://benedikt-bitterli.me/resources/
[Mitsuba]: https://www.mitsuba-renderer.org/download.html
[tutorials]: https://github.com/mitsuba-renderer/mitsuba-tutorials/tree/master/scenes
"""


def method_of(scene: str) -> str:
    """The method of a scene's picture; raises ``KeyError`` for one without."""
    if scene in PUBLIC:
        return PUBLIC[scene][3]
    for method, scenes in METHODS.items():
        if scene in scenes.split():
            return method
    raise KeyError(f"{scene}: add it to METHODS of {__file__}")


def command_of(scene: str) -> str:
    """The command of a scene's picture."""
    method = method_of(scene)
    if method == "lines":
        return f"etendue radiosity {scene} --bundles 256 -o picture.png"
    output = "--for-denoising -o picture.exr" if method in DENOISED else "-o picture.png"
    if scene not in PUBLIC:
        return f"etendue render {scene} --method {method} --time 12 {output}"
    *_, file, size = PUBLIC[scene]
    return f"etendue render {file} --method {method} --size {size} --time 60 {output}"


def page() -> str:
    """The text of the page."""
    rows = [COMPARED[k : k + 3] for k in range(0, len(COMPARED), 3)]
    text = HEAD
    for k, row in enumerate(rows):
        text += "|" + "".join(f" ![caustics by {name}](images/gallery/by-{name}.jpg) |" for name in row) + "\n"
        text += "|---|---|---|\n" * (k == 0)
        text += "|" + "".join(f" [`{name}`](methods/{name}.md) |" for name in row) + "\n"
    text += SEEN
    for name, scene in bundled().items():
        text += f"## {name}\n\n{scene.description[0].upper() + scene.description[1:]}. {shown(name)}"
    text += "## Public scenes\n\nGet these where they are published; the command is given in their folder.\n\n"
    for name, (title, author, where, *_) in PUBLIC.items():
        text += f"### {title}\n\nBy {author}, from [{where}]. {shown(name)}"
    return text.rstrip() + "\n" + LINKS


def shown(name: str) -> str:
    """Method, command and picture of a scene."""
    method = method_of(name)
    link = "[radiosity by lines](radiosity.md)" if method == "lines" else f"[`{method}`](methods/{method}.md)"
    denoised = ", denoised" * (method in DENOISED)
    return f"By {link}{denoised}:\n\n    {command_of(name)}\n\n![{name}](images/gallery/{name}.jpg)\n\n"


def run(command: str, folder: str) -> None:
    """Run a command of the page in a folder."""
    subprocess.run([sys.executable, "-m", *shlex.split(command)], cwd=folder, check=True)


def write_picture(picture: Image.Image, name: str) -> None:
    """Write a picture of the page, as good as the limit of bytes allows."""
    PICTURES.mkdir(exist_ok=True)
    file = PICTURES / f"{name}.jpg"
    small = picture.convert("RGB").resize((WIDTH, round(WIDTH * picture.height / picture.width)), Image.Resampling.BOX)
    for quality in range(88, 20, -4):
        small.save(file, quality=quality, optimize=True)
        if file.stat().st_size <= MOST_BYTES:
            return


def write_comparison() -> None:
    """Render and write the pictures of the methods, with the exposure of the last."""
    with tempfile.TemporaryDirectory() as folder:
        run(COMPARISON, folder)
        pictures = {name: film.read_image(Path(folder, "comparison", f"{name}.exr")) for name in COMPARED}
    exposure = display.auto_exposure(pictures[COMPARED[-1]])
    for name, picture in pictures.items():
        factor = max(picture.shape[1] // WIDTH, 1)
        small = film.block_average(np.asarray(picture)[..., :3], factor)
        write_picture(Image.fromarray(display.tonemap(small, exposure)), f"by-{name}")


def main(again: list[str]) -> None:
    """Write the page and the pictures that are missing or named."""
    if "methods" in again or not (PICTURES / f"by-{COMPARED[-1]}.jpg").exists():
        write_comparison()
    for name in [*bundled(), *PUBLIC]:
        if name in again or not (PICTURES / f"{name}.jpg").exists():
            with tempfile.TemporaryDirectory() as folder:
                for entry in Path(os.environ["PUBLIC_SCENES"]).iterdir() if name in PUBLIC else ():
                    Path(folder, entry.name).symlink_to(entry.resolve())
                run(command_of(name), folder)
                if method_of(name) in DENOISED:
                    run(DENOISE, folder)
                write_picture(Image.open(Path(folder, "picture.png")), name)
    PAGE.write_text(page(), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
