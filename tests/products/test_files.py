"""Files of products: checked before, written one by one, rescued where that fails."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from etendue.core import OptionError, OutputError, SceneError
from etendue.products import Writing, check_files, listed
from etendue.products.files import rescued


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def fail(path):
    raise MemoryError("too much")


def write(path):
    path.write_text("here")


def test_one_path_or_several():
    assert listed("a.exr") == (Path("a.exr"),) == listed(Path("a.exr"))
    assert listed(["a.exr", Path("b.png")]) == (Path("a.exr"), Path("b.png"))


def test_a_name_serves_one_output(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    check_files([Path("a"), tmp_path / "b"])
    with pytest.raises(OptionError, match=r"'.*a' is named for two outputs; give each a name of its own"):
        check_files([Path("a"), Path("b"), tmp_path / "a"])
    with pytest.raises(OutputError, match="there is no folder"):
        check_files([Path("nowhere/a")])
    assert list(tmp_path.iterdir()) == []


def test_the_first_way_that_succeeds_is_taken(temporary):
    assert rescued("a.exr", ("", write)).name == "a.exr"
    found = rescued("a.exr", ("", fail), (".npz", write))
    assert found.name == "a.exr.npz" and found.read_text() == "here" and temporary in found.parents
    kept = sorted(temporary.iterdir())
    assert rescued("a.exr", ("", fail), (".npz", fail)) is None
    assert sorted(temporary.iterdir()) == kept


def test_one_failure_keeps_no_other_file_from_being_written(tmp_path):
    writing = Writing()
    with writing.attempt("write 'a'", lambda: "; it is in 'b' instead"):
        fail(tmp_path)
    with writing.attempt("write 'c'"):
        write(tmp_path / "c")
    assert (tmp_path / "c").exists()
    with pytest.raises(OutputError, match="cannot write 'a': MemoryError: too much; it is in 'b' instead") as caught:
        writing.finish()
    assert isinstance(caught.value.__cause__, MemoryError)


def test_a_failure_keeps_its_kind_and_several_are_one():
    writing = Writing()
    writing.finish()
    with writing.attempt("read"):
        raise SceneError("no such scene")
    with pytest.raises(SceneError, match=r"^no such scene$"):
        writing.finish()
    with writing.attempt("write 'a'"):
        fail(None)
    with pytest.raises(OutputError, match=r"^no such scene; cannot write 'a': MemoryError: too much$"):
        writing.finish()


def test_an_interruption_is_no_failure():
    with pytest.raises(KeyboardInterrupt), Writing().attempt("write 'a'"):
        raise KeyboardInterrupt
