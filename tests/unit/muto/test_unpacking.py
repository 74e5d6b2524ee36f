"""An archive is unpacked as its tool would do it, or refused."""

from __future__ import annotations

import io
import random
import stat
import tarfile
import zipfile

import pytest

from rigel_k8s.system.trees import Directory, File, Link
from rigel_muto import unpacking
from rigel_muto.unpacking import BadArchive, check_tree, enter, flatten, unpack

from .packing import WORKSPACE, make_member, make_tar, pack, pack_zip


@pytest.mark.parametrize("compression", ["", "gz", "bz2", "xz", "zip"])
def test_all_packings_give_the_same_files(compression: str) -> None:
    """Content and the right to execute are kept."""
    packed = pack_zip(WORKSPACE) if compression == "zip" else pack(WORKSPACE, compression)
    tree = unpack(packed)
    assert {path: entry.content.decode() for path, entry in tree.items()} == WORKSPACE  # type: ignore[union-attr]
    assert [path for path, entry in tree.items() if entry.executable] == [  # type: ignore[union-attr]
        "src/left/scripts/look.py"
    ]


def test_a_tar_of_a_directory_begins_with_a_dot() -> None:
    """As `tar -C DIRECTORY -c .` packs it; empty directories and links inside stay."""
    tree = unpack(
        make_tar(
            make_member(".", type=tarfile.DIRTYPE),
            make_member("./empty", type=tarfile.DIRTYPE),
            make_member("./src/a.py", b"x"),
            make_member("./src/b.py", type=tarfile.SYMTYPE, linkname="a.py"),
            make_member("./c.py", type=tarfile.SYMTYPE, linkname="src/b.py"),
        )
    )
    check_tree(tree)
    assert tree == {
        "empty": Directory(),
        "src/a.py": File(b"x", executable=True),
        "src/b.py": Link("a.py"),
        "c.py": Link("src/b.py"),
    }


def link(name: str, target: str) -> tuple[tarfile.TarInfo, bytes]:
    return make_member(name, type=tarfile.SYMTYPE, linkname=target)


FILE = make_member("a", b"x")


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ([make_member("/etc/passwd")], '"/etc/passwd" leads out of the archive'),
        ([make_member("a/../../b")], '"a/../../b" leads out of the archive'),
        ([make_member("a\\..\\b")], "characters that no file should have"),
        ([make_member("a\nb")], "characters that no file should have"),
        ([make_member("a\x1b[2Jb")], "characters that no file should have"),
        ([make_member("a" * 256)], "is too long"),
        ([make_member("d/" * 51 + "a")], "is too long"),
        ([FILE, link("b", "/etc")], 'the link "b" leads out of the archive, to "/etc"'),
        ([FILE, link("b", "../c")], 'the link "b" leads out'),
        ([FILE, link("d/b", "../../c")], 'the link "d/b" leads out'),
        # d/up is d itself; what climbs from there is one directory higher than it looks.
        ([FILE, link("d/up", "."), link("b", "d/up/../../c")], 'the link "b" leads out'),
        (
            [link("b", "c"), make_member("b/x", b"x")],
            '"b/x" is below "b", which is not a directory',
        ),
        ([FILE, make_member("a/x", b"x")], '"a/x" is below "a", which is not a directory'),
        ([FILE, FILE], '"a" is in the archive twice'),
        ([FILE, make_member("./a")], '"./a" is in the archive twice'),
        ([FILE, make_member("b", type=tarfile.LNKTYPE, linkname="a")], "is a hard link"),
        ([FILE, make_member("b", type=tarfile.FIFOTYPE)], "is neither a file nor"),
        ([FILE, make_member("b", type=tarfile.CHRTYPE)], "is neither a file nor"),
        ([make_member("b", type=tarfile.DIRTYPE)], "there is no file in the archive"),
        ([], "there is no file in the archive"),
    ],
)
def test_what_no_archive_of_sources_has_is_refused(
    members: list[tuple[tarfile.TarInfo, bytes]], message: str
) -> None:
    with pytest.raises(BadArchive) as refused:
        check_tree(unpack(make_tar(*members)))
    assert message in str(refused.value)


def test_a_zip_is_looked_at_as_a_tar_is() -> None:
    """Names that lead out, links that lead out, and devices."""
    for name in ("/a", "../a", "a/../../b"):
        with pytest.raises(BadArchive, match="leads out"):
            unpack(pack_zip({name: "x"}))
    for kind, message in ((stat.S_IFLNK, "leads out"), (stat.S_IFIFO, "is neither a file nor")):
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w") as archive:
            archive.writestr("a", "x")
            info = zipfile.ZipInfo("b")
            info.external_attr = (kind | 0o777) << 16
            archive.writestr(info, "../../etc")
        with pytest.raises(BadArchive, match=message):
            check_tree(unpack(packed.getvalue()))


@pytest.mark.parametrize("compression", ["gz", "bz2", "xz", "zip"])
def test_a_small_archive_of_much_data_is_refused(
    compression: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where each of its files is below the limit."""
    monkeypatch.setattr(unpacking, "MOST_UNPACKED", 2**20)
    for files in ({"a": "0" * 2**21}, {f"{n}": "0" * 2**18 for n in range(8)}):
        packed = pack_zip(files) if compression == "zip" else pack(files, compression)
        assert len(packed) < 2**14
        with pytest.raises(BadArchive, match="has more than 1048576 bytes"):
            unpack(packed)


def test_the_number_of_entries_has_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Directories count as well."""
    monkeypatch.setattr(unpacking, "MOST_ENTRIES", 5)
    unpack(pack({f"{n}": "x" for n in range(5)}))
    with pytest.raises(BadArchive, match="more than 5 entries"):
        unpack(make_tar(*(make_member(f"{n}", type=tarfile.DIRTYPE) for n in range(6))))


@pytest.mark.parametrize("size", [-1, -512, -1024, 2**40])
def test_an_entry_with_a_wrong_size_ends_the_reading(size: int) -> None:
    """A negative one would lead a reader back to where it has been."""
    info, _ = FILE
    header = bytearray(info.tobuf())
    header[124:136] = (
        b"\x80" + size.to_bytes(11, "big", signed=True)
        if size > 0
        else (b"\xff" * 4 + size.to_bytes(8, "big", signed=True))
    )
    header[148:156] = b" " * 8
    header[148:156] = f"{sum(header[:512]):06o}\0 ".encode()
    with pytest.raises(BadArchive):
        unpack(bytes(header) + b"x" * 512 + b"\0" * 1024)


@pytest.mark.parametrize("compression", ["", "gz", "zip"])
def test_a_damaged_archive_is_refused_or_read(compression: str) -> None:
    """No damage ends in a traceback, or in a file outside."""
    packed = pack_zip(WORKSPACE) if compression == "zip" else pack(WORKSPACE, compression)
    chance = random.Random(7)
    refused = 0
    for _ in range(300):
        damaged = bytearray(packed[: chance.choice((len(packed), chance.randrange(len(packed))))])
        for _ in range(chance.randint(1, 4)):
            if damaged:
                damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        try:
            tree = unpack(bytes(damaged))
        except BadArchive:
            refused += 1
            continue
        assert not any(path.startswith("/") or ".." in path.split("/") for path in tree)
    assert refused > 30


def test_layouts() -> None:
    """One top directory is left out; a directory is moved to the top, beside the rest."""
    inside = {f"ws/{path}": text for path, text in WORKSPACE.items()}
    assert flatten(unpack(pack(inside))) == unpack(pack(WORKSPACE))
    tree = unpack(pack({"README": "x", **inside}))
    assert flatten(tree) == tree
    assert enter(tree, "./ws/") == unpack(pack({"README": "x", **WORKSPACE}))
    assert flatten(unpack(pack({"a.launch": "x"}))) == {"a.launch": File(b"x")}
    with pytest.raises(BadArchive, match='no directory "src"'):
        enter(tree, "src")
    with pytest.raises(BadArchive, match="leads out"):
        enter(tree, "../ws")
    with pytest.raises(BadArchive, match="beside it"):
        enter(unpack(pack({"a": "x", "ws/a": "x"})), "ws")


def test_a_link_that_its_new_place_leads_out_is_refused() -> None:
    """Links are looked at where they will be."""
    tree = unpack(make_tar(FILE, link("ws/b", "../a")))
    check_tree(tree)
    with pytest.raises(BadArchive, match="leads out"):
        check_tree(enter(tree, "ws"))
