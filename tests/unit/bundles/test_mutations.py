"""Mutations of archives that work, with their manifests: each is taken, or refused with a named cause, soon, and inside of its folder.

`DRIVECAL_LONG` in the environment makes it 10,000.
"""

import random
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path

from tests.support import effort
from tests.support.effort import tries
from tests.support.mutations import at_home, soon

from drivecal.bundles.archives import files_of, pack, remove, unpack
from drivecal.configuration.problems import read_archived
from drivecal.domain.errors import InvalidInputError

MUTATIONS = tries(200, 10_000)
LARGEST = 1 << 20
EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples" / "problems"
STRANGE = [
    b"", b"\x00", b"../", b"/", b"..", b"\xff\xfe", b"\n", b"- ", b": ", b"{", b"]", b"&a ", b"*a", b"!!python/object:os.system ", b"1e999",
    b"-1", b"nan", b"9" * 400, b"[" * 400, b"(" * 400, b"=", b"**", b"__import__('os')", b"\xe2\x80\xae", b"PK\x01\x02", b"PK\x05\x06",
    b"\xff\xff\xff\xff", b"\x00\x00\x00\x80", b"\xa0\xff", b"'", b'"', b"|", b">", b"\t", b"true", b"0x10", b"2020-01-01", b"<<: ",
    b"/etc/passwd",
]  # fmt: skip


def mutated(content: bytes, chance: random.Random) -> bytes:
    """The content with one to four faults: bytes, words of other formats, parts that are missing, twice or elsewhere."""
    for _ in range(chance.choice((1, 1, 2, 3, 4))):
        begin = chance.randrange(len(content) + 1)
        end = min(len(content), begin + chance.choice((1, 1, 2, 4, 30, 200)))
        part = chance.choice((chance.choice(STRANGE), bytes([chance.randrange(256)]), content[begin:end] * 2, b""))
        content = content[:begin] + part + content[end:]
        if chance.random() < 0.2:
            place = chance.randrange(len(content) + 1)
            content = content[:place] + content[begin : begin + 40] + content[place:]
        if chance.random() < 0.05:
            content = content[: chance.randrange(len(content) + 1)]
    return content


def overwritten(content: bytes, chance: random.Random) -> bytes:
    """The content with one to three other places, each as long as before: offsets in an archive stay right."""
    for _ in range(chance.choice((1, 1, 2, 3))):
        part = chance.choice((chance.choice(STRANGE), bytes([chance.randrange(256)])))[: len(content)]
        begin = chance.randrange(len(content) - len(part) + 1)
        content = content[:begin] + part + content[begin + len(part) :]
    return content


def rewritten(content: bytes, chance: random.Random) -> bytes:
    """Returns a sound archive with unusual names and kinds of files."""
    written = BytesIO()
    with zipfile.ZipFile(BytesIO(content)) as source, zipfile.ZipFile(written, "w") as target:
        for entry in source.infolist():
            if chance.random() < 0.5:
                strange = chance.choice(STRANGE).decode("latin-1")
                entry.filename = chance.choice((strange + entry.filename, entry.filename + strange, f"sub/{entry.filename}"))
            if chance.random() < 0.2:
                entry.external_attr = chance.randrange(1 << 16) << 16
            target.writestr(entry, b"../outside" if chance.random() < 0.1 else b"content")
    return written.getvalue()


def taken(attempt: Callable[[], object]) -> bool:
    """Returns whether the attempt succeeds. A refusal must name the fault."""
    refusal = None
    with soon(), at_home():
        try:
            attempt()
        except InvalidInputError as error:
            refusal = error
    assert refusal is None or (refusal.problems and all(problem.message for problem in refusal.problems))
    return refusal is None


def archives() -> Iterator[bytes]:
    """Archives of each kind: as they are pushed, stored instead of deflated, with folders."""
    yield pack(EXAMPLES / "python-function")
    yield pack(EXAMPLES / "command-shell")
    content = BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr("problem.yaml", "problem: p\n")
        archive.writestr("deep/", b"")
        archive.writestr("deep/data", bytes(5000))
    yield content.getvalue()


def test_mutated_archives_are_refused_or_unpacked_inside_of_their_folder(tmp_path: Path) -> None:
    chance, subjects, results = effort.chance("archives"), list(archives()), []
    target, outside = tmp_path / "inside" / "target", tmp_path / "outside"
    outside.write_text("content")
    target.parent.mkdir()
    for number in range(MUTATIONS):
        damage = chance.choice((mutated, overwritten, overwritten, rewritten))
        damaged = damage(subjects[number % len(subjects)], chance)

        def attempt(damaged: bytes = damaged) -> None:
            files = files_of(damaged, LARGEST)
            assert sum(len(file.content) for file in files.values()) <= LARGEST
            with suppress(InvalidInputError):
                read_archived(files)
            unpack(damaged, target)

        results.append(taken(attempt))
        if target.exists():
            assert not any(path.is_symlink() for path in target.rglob("*"))
            remove(target)
        assert sorted(path.name for path in tmp_path.rglob("*")) == ["inside", "outside"]
    assert outside.read_text() == "content"
    assert any(results)
    assert not all(results)
