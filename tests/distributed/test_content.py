"""Files by content: sent in pieces, found again, refused if damaged or if the disk is full."""

from __future__ import annotations

import errno
import os

import pytest

from etendue.core import ClusterError
from etendue.distributed import ContentFile, Offered, Store, content as content_module


def send(offered, digest, store):
    for piece in offered.pieces(digest):
        store.receive(digest, *piece)


@pytest.mark.parametrize("size", [0, 1, 99, 100, 101, 1000])
def test_a_file_arrives_whole_whatever_its_pieces(size, tmp_path, monkeypatch):
    monkeypatch.setattr(content_module, "PIECE", 100)
    original = tmp_path / "original"
    original.write_bytes((bytes(range(256)) * 4)[:size])
    offered, store = Offered(), Store(tmp_path / "store")
    entry = offered.add(original)
    assert store.find(entry) == original  # the same machine: nothing to send
    elsewhere = ContentFile(entry.digest, entry.size, "/no/such/file")
    assert store.find(elsewhere) is None
    send(offered, entry.digest, store)
    assert store.find(elsewhere).read_bytes() == original.read_bytes()


def test_another_content_at_the_place_of_the_client_is_not_taken(tmp_path):
    original = tmp_path / "original"
    original.write_bytes(b"abc")
    entry = Offered().add(original)
    original.write_bytes(b"abd")
    os.utime(original, ns=(1, 1))  # clocks of files may be too coarse to tell both apart
    assert Store(tmp_path / "store").find(entry) is None


def test_a_file_that_is_gone_is_named(tmp_path):
    offered, original = Offered(), tmp_path / "original"
    original.write_bytes(b"abc")
    digest = offered.add(original).digest
    original.unlink()
    with pytest.raises(ClusterError, match=r"original' cannot be sent \(No such file or directory\)"):
        send(offered, digest, Store(tmp_path / "store"))


def test_a_file_that_changes_on_its_way_is_refused(tmp_path):
    offered, store = Offered(), Store(tmp_path / "store")
    digest = offered.add(b"abc").digest
    offered.contents[digest] = b"abd"
    with pytest.raises(ClusterError, match="changed while it was sent"):
        send(offered, digest, store)
    assert store.find(ContentFile(digest, 3)) is None


def test_a_full_disk_is_one_line_with_the_folder(tmp_path, monkeypatch):
    store = Store(tmp_path / "store")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(content_module.os, "replace", full)
    with pytest.raises(ClusterError, match=r"store' cannot hold the scene \(No space left on device\); free some room"):
        store.receive(Offered().add(b"a").digest, 0, b"a", True)


@pytest.mark.parametrize("place", ["../x", "/etc/x", "a/../../x"])
def test_links_stay_in_the_folder(place, tmp_path):
    with pytest.raises(ClusterError, match="no place in the folder"):
        Store(tmp_path / "store").tree("0123456789", {place: tmp_path})


def test_a_folder_of_others_is_refused(tmp_path):
    (tmp_path / "store").mkdir()
    (tmp_path / "store").chmod(0o777)
    with pytest.raises(ClusterError, match="others may write"):
        Store(tmp_path / "store")


def test_old_files_of_others_in_the_folder_stay(tmp_path):
    """ETENDUE_CONTENT may name a folder that has other files."""
    store, offered = Store(tmp_path), Offered()
    mine = offered.add(b"abc")
    send(offered, mine.digest, store)
    others = tmp_path / "thesis.tex", tmp_path / "pictures" / "one.exr"
    for file in others:
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(b"x")
    links = store.tree(mine.digest, {"scene.xml": tmp_path / mine.digest})  # of a worker that was killed
    part = tmp_path / f"{mine.digest}.7.part"
    part.write_bytes(b"a")
    for path in tmp_path.rglob("*"):
        os.utime(path, (0, 0), follow_symlinks=False)
    store.tidy()
    assert all(file.is_file() for file in others)
    assert not links.exists() and not part.exists() and store.find(mine) is None


def test_what_fills_a_disk_is_removed(tmp_path, monkeypatch):
    store, opened = Store(tmp_path), content_module.Path.open

    class Full:
        def __init__(self, file):
            self._file = file

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self._file.close()

        def seek(self, offset): ...

        def write(self, piece):
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(content_module.Path, "open", lambda path, mode: Full(opened(path, mode)))
    with pytest.raises(ClusterError, match="No space left on device"):
        store.receive(Offered().add(b"a").digest, 0, b"a", True)
    assert not list(tmp_path.iterdir())


def test_a_link_in_a_folder_of_all_is_not_followed(tmp_path, monkeypatch):
    monkeypatch.delenv(content_module.FOLDER_VARIABLE, raising=False)
    monkeypatch.setattr(content_module.tempfile, "gettempdir", lambda: str(tmp_path))
    (tmp_path / "home").mkdir()
    (tmp_path / f"etendue-content-{os.getuid()}").symlink_to(tmp_path / "home")
    with pytest.raises(ClusterError, match="others may write"):
        Store()
