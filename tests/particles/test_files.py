"""Files of particles: parts of them, files that were cut off or damaged, and runs that go on."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import mitsuba as mi
import numpy as np
import pytest
from support.particles import POWER, box, sorted_rows
from support.scenes import camera, diffuse

import etendue
from etendue.core import CheckpointError, EtendueError, OptionError, OutputError
from etendue.engine import RunError, remaining
from etendue.methods import ParticleTracing
from etendue.particles import ParticleError, ParticleFile, Particles, ParticleWriter, blocks
from etendue.products import saved_task
from etendue.products.particles import repack
from etendue.scene import load

PATHS = 4000


@cache
def scene():
    return load(box()).scene


@cache
def whole() -> Path:
    """A file of four passes."""
    path = Path(mkdtemp()) / "whole.particles"
    etendue.trace_particles(scene(), paths=4 * PATHS, save=path, samples_per_pass=PATHS, seed=2)
    return path


def cut(path: Path, size: int) -> Path:
    path.write_bytes(whole().read_bytes()[:size])
    return path


def equal(one: Particles, two: Particles) -> None:
    np.testing.assert_array_equal(sorted_rows(one.rows), sorted_rows(two.rows))


def test_a_file_has_what_was_traced():
    known = ParticleFile(whole())
    in_memory = etendue.trace_particles(scene(), paths=4 * PATHS, samples_per_pass=PATHS, seed=2).particles
    particles = known.read()
    assert known.is_finished and known.paths == 4 * PATHS and len(known.passes) == 4
    assert len(known) == len(particles) == len(in_memory)
    np.testing.assert_array_equal(known.counts, np.bincount(in_memory.shape, minlength=6))
    np.testing.assert_allclose(known.power, in_memory.power.sum(0, dtype=float), rtol=1e-6)
    np.testing.assert_allclose(particles.power.sum(0, dtype=float), known.power, rtol=1e-3)
    np.testing.assert_allclose(known.power, POWER / 0.5, rtol=0.05)
    assert known.header["fingerprint"] == load(scene()).fingerprint


@pytest.mark.parametrize("codec", ["raw", "exact", "exact+zlib"])
def test_codecs_without_loss_return_the_same(codec, tmp_path):
    path = tmp_path / "a.particles"
    etendue.trace_particles(scene(), paths=PATHS, save=path, codec=codec, seed=2)
    equal(etendue.read_particles(path), etendue.trace_particles(scene(), paths=PATHS, seed=2).particles)
    assert ParticleFile(path).bounds == {}


def test_parts_by_surface_and_region(monkeypatch):
    known, everything = ParticleFile(whole()), etendue.read_particles(whole())
    read = []
    payload = blocks.Block.payload
    monkeypatch.setattr(blocks.Block, "payload", lambda self, file: (read.append(self), payload(self, file))[1])
    floor = etendue.read_particles(whole(), shapes=["floor"])
    equal(floor, everything[everything.shape == known.shape("floor")])
    low, high = np.array([-1.1, -1.1, -1.1]), np.array([0.2, -0.5, 0.1])
    inside = ((everything.position >= low) & (everything.position <= high)).all(1)
    equal(known.read(box=[low, high]), everything[inside])
    equal(
        known.read([known.shape("left")], [low, high]), everything[inside & (everything.shape == known.shape("left"))]
    )
    assert read
    read.clear()
    assert len(known.read(box=[[5, 5, 5], [6, 6, 6]])) == 0
    assert read == []


def test_only_chunks_with_the_surface_are_read(monkeypatch, tmp_path):
    monkeypatch.setattr("etendue.particles.packing.codecs.CHUNK", 500)
    path = tmp_path / "a.particles"
    etendue.trace_particles(scene(), paths=2 * PATHS, save=path, samples_per_pass=PATHS)
    known, read = ParticleFile(path), []
    payload = blocks.Block.payload
    monkeypatch.setattr(blocks.Block, "payload", lambda self, file: (read.append(self), payload(self, file))[1])
    count = len(known.read(["back"]))
    assert count == known.counts[known.shape("back")] > 0
    assert len(read) <= 2 * (count / 2 / 500 + 3) < len(known.chunks) / 2


def test_curved_shapes_and_instances(tmp_path):
    """Their particles are within the bounds, too, and an instance is one shape."""
    place, half = mi.ScalarTransform4f, diffuse(0.5, 0.5, 0.5)
    group = {
        "type": "shapegroup",
        "cube": {"type": "cube", "to_world": place().scale(0.1), "bsdf": half},
        "ball": {"type": "sphere", "radius": 0.1, "center": [0.3, 0, 0], "bsdf": half},
    }
    instance = {"type": "instance", "of": {"type": "ref", "id": "group"}}
    source = box(
        group=group,
        one=instance | {"to_world": place().translate([0, -0.6, 0])},
        two=instance | {"to_world": place().translate([0, 0.6, 0.3])},
        ball={"type": "sphere", "center": [0.5, 0, 0.5], "radius": 0.15, "bsdf": half},
        disk={"type": "disk", "to_world": place().translate([-0.5, 0, 0]).scale(0.2), "bsdf": half},
        tube={"type": "cylinder", "p0": [-0.5, 0.5, 0.5], "p1": [0.2, 0.5, 0.5], "radius": 0.05, "bsdf": half},
    )
    found = {}
    for codec in ("exact", "packed"):
        path = tmp_path / f"{codec}.particles"
        etendue.trace_particles(source, paths=20_000, save=path, codec=codec)
        particles = etendue.read_particles(path)
        found[codec] = particles[np.lexsort((particles.bounce, particles.path))]
    known, exact, packed = ParticleFile(path), found["exact"], found["packed"]
    for name in ("one", "two", "ball", "disk", "tube"):
        assert known.counts[known.shape(name)] > 200
        assert len(known.read([name])) == known.counts[known.shape(name)]
    away = np.linalg.norm(packed.position.astype(float) - exact.position, axis=1)
    assert away.max() <= known.bounds["position"] < 1e-4
    on_ball = packed.position[packed.shape == known.shape("ball")]
    np.testing.assert_allclose(np.linalg.norm(on_ball - [0.5, 0, 0.5], axis=1), 0.15, atol=1e-4)
    np.testing.assert_array_equal(packed.primitive, exact.primitive)
    np.testing.assert_allclose(packed.uv, exact.uv, atol=1e-4)


def test_a_shape_whose_name_is_a_number():
    known = ParticleFile(whole())
    known.surfaces.names = ["left", "right", "floor", "back", "1", "lamp"]
    assert [known.shape(name) for name in ("1", 1, "2", "floor")] == [4, 1, 2, 2]


def test_shapes_and_regions_that_do_not_exist():
    known = ParticleFile(whole())
    with pytest.raises(ParticleError, match=r"there is no shape 'flor' .* did you mean 'floor'"):
        known.read(["flor"])
    with pytest.raises(ParticleError, match=r"there is no shape 6: .* has shapes 0 to 5"):
        known.read([6])
    with pytest.raises(ParticleError, match="a lower and an upper corner"):
        known.read(box=[[1, 1, 1], [0, 0, 0]])


def test_a_file_that_was_cut_off_has_its_whole_passes(tmp_path):
    known, size = ParticleFile(whole()), whole().stat().st_size
    ends = [block.end for block in known.passes]
    first = known.chunks[0].start
    for place in (first, first + 10, ends[0] - 1, ends[0], ends[1] + 5, ends[2], ends[3], ends[3] + 40, size - 1):
        part = ParticleFile(cut(tmp_path / "cut.particles", place))
        passes = sum(end <= place for end in ends)
        assert len(part.passes) == passes and not part.is_finished
        assert part.paths == passes * PATHS
        scaled = known.chunks[: len(part.chunks)]
        assert len(part.read()) == len(part) == sum(block.head["count"] for block in scaled)


def test_a_run_that_goes_on_gives_the_same_file(tmp_path):
    """Cut off in the middle of the third pass, as by a kill, and of the index."""
    known = ParticleFile(whole())
    inside = (known.passes[1].end + known.passes[2].end) // 2
    for place in (inside, known.passes[2].end + 3, whole().stat().st_size - 20):
        path = cut(tmp_path / "cut.particles", place)
        result = etendue.resume(path, scene=scene())
        assert result.passes == 4 and result.counters["paths"] == 4 * PATHS
        equal(etendue.read_particles(path), etendue.read_particles(whole()))
        assert [block.head["crc"] for block in ParticleFile(path).chunks] == [b.head["crc"] for b in known.chunks]


def test_a_killed_run_goes_on_with_its_last_budget(tmp_path):
    """That of the run that was killed, not of the first one."""
    path = tmp_path / "a.particles"
    path.write_bytes(whole().read_bytes())
    etendue.resume(path, scene=scene(), paths=7 * PATHS)
    cut_off = path.read_bytes()[: ParticleFile(path).passes[4].end + 100]
    path.write_bytes(cut_off)
    assert etendue.resume(path, scene=scene()).passes == 7


def test_a_finished_run_goes_on_with_a_new_budget(tmp_path):
    path = cut(tmp_path / "a.particles", -1)
    path.write_bytes(whole().read_bytes())
    with pytest.raises(CheckpointError, match="the budget of the checkpoint is used up"):
        etendue.resume(path, scene=scene())
    etendue.resume(path, scene=scene(), paths=5 * PATHS)
    equal(
        etendue.read_particles(path),
        _packed(scene(), tmp_path / "b.particles", paths=5 * PATHS, samples_per_pass=PATHS, seed=2),
    )


def _packed(source, path, **options) -> Particles:
    etendue.trace_particles(source, save=path, **options)
    return etendue.read_particles(path)


def test_a_callback_ends_the_run_and_the_file_is_whole(tmp_path):
    path = tmp_path / "a.particles"
    options = {"paths": 4 * PATHS, "samples_per_pass": PATHS}
    result = etendue.trace_particles(scene(), save=path, callback=lambda update: update.progress.passes < 2, **options)
    assert result.stopped_by == "cancel" and result.particles is None
    assert len(ParticleFile(path).passes) == 2
    etendue.resume(path, scene=scene())
    assert ParticleFile(path).paths == 4 * PATHS


def test_particles_of_another_scene_do_not_go_on(tmp_path):
    path = cut(tmp_path / "a.particles", ParticleFile(whole()).passes[1].end)
    other = load(box((0.25, 0.25, 0.25)))
    with pytest.raises(CheckpointError, match="the scene is not the one"):
        etendue.resume(path, scene=other.scene)
    with pytest.raises(ParticleError, match="has particles of another scene"):
        ParticleFile(path).require_scene(other)
    from_elsewhere = load(box() | {"sensor": camera(size=(40, 30), origin=(0.5, 0.0, 0.5), target=(0.0, 0.0, 0.0))})
    ParticleFile(path).require_scene(from_elsewhere)
    assert from_elsewhere.fingerprint != ParticleFile(path).header["fingerprint"]
    assert len(ParticleFile(path).passes) == 2


def test_a_damaged_chunk_is_one_line(tmp_path):
    path, block = tmp_path / "a.particles", ParticleFile(whole()).chunks[1]
    data = bytearray(whole().read_bytes())
    data[(block.start + block.end) // 2] ^= 4
    path.write_bytes(data)
    with pytest.raises(ParticleError, match=rf"is damaged: {block.head['count']} particles of pass 1 cannot be read"):
        etendue.read_particles(path)


def without_index(path: Path, flipped: int | None = None) -> Path:
    """As after a kill behind the last pass; with a flipped bit."""
    data = bytearray(whole().read_bytes()[: ParticleFile(whole()).passes[-1].end])
    if flipped is not None:
        data[flipped] ^= 4
    path.write_bytes(data)
    return path


def test_passes_behind_a_damage_are_not_removed(tmp_path, caplog):
    known = ParticleFile(whole())
    path = without_index(tmp_path / "a.particles", known.chunks[1].start - 30)
    before = path.read_bytes()
    with caplog.at_level("WARNING"):
        damaged = ParticleFile(path)
    assert "is damaged behind its first 1 passes: 3 more are left out" in caplog.text
    assert len(damaged.passes) == 1 and damaged.lost == 3
    with pytest.raises(OutputError, match="to go on would remove 3 whole passes behind the damage"):
        etendue.resume(path, scene=scene(), paths=9 * PATHS)
    assert path.read_bytes() == before
    assert ParticleFile(without_index(path)).lost == 0


def test_two_runs_do_not_write_to_one_file(tmp_path):
    path, errors = tmp_path / "a.particles", []

    def second(_):
        with pytest.raises(OutputError, match="another run writes to"):
            etendue.resume(path, scene=scene(), paths=9 * PATHS)
        errors.append(1)

    etendue.trace_particles(scene(), save=path, callback=second, paths=2 * PATHS, samples_per_pass=PATHS, max_bounces=3)
    assert errors == [1, 1]
    assert len(ParticleFile(path).passes) == 2 and ParticleFile(path).paths == 2 * PATHS


def test_a_file_that_cannot_be_resumed_is_closed(tmp_path, monkeypatch):
    """Its lock is given back, even while the error is kept."""
    known = ParticleFile(cut(tmp_path / "a.particles", -1))

    def fail(_):
        raise OSError("on purpose")

    with monkeypatch.context() as patch, pytest.raises(OutputError, match="on purpose") as caught:
        patch.setattr("etendue.particles.writer.os.fstat", fail)
        ParticleWriter.resume(known)
    ParticleWriter.resume(known).close()
    assert caught.tb is not None


def test_a_file_that_has_changed_since_it_was_read_is_not_cut(tmp_path):
    path = without_index(tmp_path / "a.particles")
    known = ParticleFile(path)
    path.write_bytes(whole().read_bytes())
    with pytest.raises(OutputError, match="has changed since it was read"):
        ParticleWriter.resume(known)
    assert path.read_bytes() == whole().read_bytes()


def test_a_killed_run_goes_on_with_the_rest_of_its_time(tmp_path):
    path = tmp_path / "a.particles"
    stop = iter([True, True, False])
    etendue.trace_particles(scene(), save=path, seconds=1000.0, callback=lambda _: next(stop), samples_per_pass=PATHS)
    known = ParticleFile(path)
    path.write_bytes(path.read_bytes()[: known.passes[-1].end])
    assert not ParticleFile(path).is_finished
    task, saved = saved_task(path, scene=scene())
    spent, seconds = known.passes[-1].head["elapsed"], known.counters["seconds"]
    assert not task.budget and remaining(saved).seconds == pytest.approx(1000.0 - spent)
    assert 0 < seconds <= spent
    assert saved.measurement.counters["seconds"] == seconds


def test_packing_a_file_that_is_not_finished(tmp_path):
    path, packed = without_index(tmp_path / "a.particles"), tmp_path / "b.particles"
    repack(path, packed, "exact")
    assert len(ParticleFile(packed).passes) == 4 and not ParticleFile(packed).is_finished
    repack(whole(), tmp_path / "c.particles", "exact")
    assert ParticleFile(tmp_path / "c.particles").is_finished
    with pytest.raises(CheckpointError, match="the budget of the checkpoint is used up"):
        etendue.resume(tmp_path / "c.particles", scene=scene())


def test_a_run_without_a_pass_leaves_no_file(tmp_path, monkeypatch):
    path = tmp_path / "a.particles"

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(ParticleTracing, "step", interrupted)
    with pytest.raises(KeyboardInterrupt):
        etendue.trace_particles(scene(), save=path, paths=PATHS)
    assert not path.exists()


def test_parts_by_pass():
    known = ParticleFile(whole())
    found: dict[int, int] = {}
    for number, part in known.parts_by_pass():
        found[number] = found.get(number, 0) + len(part)
    assert found == {int(p.head["pass"]): p.head["counters"]["particles"] for p in known.passes}


def test_primitives_of_an_instance_are_different(tmp_path):
    """Each member of a group has primitives of its own."""
    place, half = mi.ScalarTransform4f, diffuse(0.5, 0.5, 0.5)
    group = {
        "type": "shapegroup",
        "one": {"type": "cube", "to_world": place().translate([0.5, 0, 0]).scale(0.2), "bsdf": half},
        "ball": {"type": "sphere", "radius": 0.2, "bsdf": half},
        "two": {"type": "cube", "to_world": place().translate([-0.5, 0, 0]).scale(0.2), "bsdf": half},
    }
    lamp = {"type": "point", "position": [0, 0.7, 0], "intensity": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
    source = box(group=group, it={"type": "instance", "of": {"type": "ref", "id": "group"}}, lamp=lamp)
    particles = etendue.trace_particles(source, paths=20_000).particles
    names = [shape.id() for shape in load(source).scene.shapes()]
    on = particles[particles.shape == names.index("it")]
    x = on.position[:, 0]
    one, ball, two = (set(on.primitive[side]) for side in (x > 0.25, np.abs(x) < 0.25, x < -0.25))
    assert len(one) >= 6 and len(two) >= 6 and len(ball) == 1
    assert not one & two and not ball & (one | two)


def test_files_that_are_not_of_particles(tmp_path):
    path = tmp_path / "a.particles"
    with pytest.raises(ParticleError, match="there is no file"):
        etendue.read_particles(path)
    for data in (b"", b"something else", whole().read_bytes()[:50]):
        path.write_bytes(data)
        with pytest.raises(ParticleError, match="is not a file of particles"):
            etendue.read_particles(path)
    path.write_bytes(whole().read_bytes()[: ParticleFile(whole()).chunks[0].start - 40])
    assert len(etendue.read_particles(path)) == 0


def test_a_file_of_another_version(tmp_path, monkeypatch):
    path = tmp_path / "a.particles"
    monkeypatch.setattr(blocks, "FORMAT", 99)
    etendue.trace_particles(scene(), paths=PATHS, save=path)
    monkeypatch.undo()
    with pytest.raises(ParticleError, match="has format 99, this étendue reads format 2"):
        etendue.read_particles(path)


@contextmanager
def room_for(size: int) -> Iterator[None]:
    """Files may have no more bytes than this, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_keeps_what_is_written(tmp_path):
    path, third = tmp_path / "a.particles", ParticleFile(whole()).passes[2].end
    options = {"paths": 4 * PATHS, "samples_per_pass": PATHS, "seed": 2}
    with room_for(third - 100), pytest.raises(RunError, match="it has the particles of 2 passes: free some space") as e:
        etendue.trace_particles(scene(), save=path, **options)
    assert "\n" not in str(e.value)
    assert len(ParticleFile(path).passes) == 2
    etendue.resume(path, scene=scene())
    equal(etendue.read_particles(path), etendue.read_particles(whole()))


def test_an_existing_file_is_not_overwritten(tmp_path):
    path = tmp_path / "a.particles"
    path.write_text("dear diary")
    with pytest.raises(OptionError, match="exists: choose another name"):
        etendue.trace_particles(scene(), paths=PATHS, save=path)
    with pytest.raises(EtendueError, match="exists: choose another name"):
        repack(whole(), path, "exact")
    assert path.read_text() == "dear diary"
    with pytest.raises(EtendueError, match="there is no folder"):
        etendue.trace_particles(scene(), paths=PATHS, save=tmp_path / "none" / "a.particles")


def test_packing_anew(tmp_path):
    exact = tmp_path / "exact.particles"
    etendue.trace_particles(scene(), paths=2 * PATHS, save=exact, codec="raw", samples_per_pass=PATHS, seed=2)
    packed, twice = tmp_path / "packed.particles", tmp_path / "twice.particles"
    repack(exact, packed, "packed")
    equal(
        etendue.read_particles(packed),
        _packed(scene(), tmp_path / "d", paths=2 * PATHS, samples_per_pass=PATHS, seed=2),
    )
    assert packed.stat().st_size < 0.4 * exact.stat().st_size
    repack(packed, twice, "exact+bz2")
    equal(etendue.read_particles(packed), etendue.read_particles(twice))
    assert ParticleFile(twice).bounds == ParticleFile(packed).bounds != {}
    etendue.resume(twice, scene=scene(), paths=3 * PATHS)
    assert ParticleFile(twice).paths == 3 * PATHS
