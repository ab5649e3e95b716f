"""Files that appear whole, as public as any other, and stay."""

from __future__ import annotations

import os
import stat

import pytest

from etendue.core import OutputError
from etendue.film import check_writable, replacing, write_bytes


@pytest.mark.skipif(os.name != "posix", reason="modes of POSIX")
@pytest.mark.parametrize(("mask", "mode"), [(0o027, 0o640), (0o000, 0o666), (0o077, 0o600)])
def test_a_file_is_as_public_as_others_and_the_mask_of_the_process_is_never_changed(tmp_path, monkeypatch, mask, mode):
    before = os.umask(mask)
    try:
        with monkeypatch.context() as patched:
            patched.setattr(os, "umask", lambda _: pytest.fail("between two calls another thread writes files for all"))
            write_bytes(tmp_path / "picture.png", b"1")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "picture.png").stat().st_mode) == mode


@pytest.mark.skipif(os.name != "posix", reason="folders are files on POSIX alone")
def test_the_file_is_on_the_disk_before_it_is_renamed_and_the_folder_after_that(tmp_path, monkeypatch):
    synced, sync = [], os.fsync

    def record(handle):
        synced.append((stat.S_ISDIR(os.fstat(handle).st_mode), (tmp_path / "picture.png").exists()))
        sync(handle)

    monkeypatch.setattr(os, "fsync", record)
    write_bytes(tmp_path / "picture.png", b"1")
    assert synced == [(False, False), (True, True)]


def test_a_folder_that_cannot_be_synced_has_the_file(tmp_path, monkeypatch):
    sync = os.fsync

    def refuse(handle):
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError("not supported")
        sync(handle)

    monkeypatch.setattr(os, "fsync", refuse)
    write_bytes(tmp_path / "picture.png", b"1")
    assert (tmp_path / "picture.png").read_bytes() == b"1"


def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "picture.png"
    write_bytes(path, b"old")
    with pytest.raises(RuntimeError), replacing(path) as part:
        part.write_bytes(b"new")
        raise RuntimeError
    check_writable(path)
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
    with pytest.raises(OutputError, match="there is no folder"):
        write_bytes(tmp_path / "none" / "picture.png", b"")
