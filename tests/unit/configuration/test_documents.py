"""Reading campaign files."""

import io
import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import faulty_fields

from drivecal.configuration.documents import LARGEST_FILE, opened_document, read_document
from drivecal.contracts import strict_json
from drivecal.domain.errors import InvalidInputError, Problem

finite = st.floats(allow_nan=False, allow_infinity=False)
plain: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**20), 10**20) | finite | st.text(st.characters(codec="utf-8")),
    lambda children: st.lists(children) | st.dictionaries(st.text(st.characters(codec="utf-8")), children),
    max_leaves=15,
)


def read(tmp_path: Path, content: str | bytes, name: str = "campaign.yaml") -> dict[str, Any]:
    file = tmp_path / name
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_document(str(file))


def test_yaml_is_read_by_its_core_schema(tmp_path: Path) -> None:
    text = """
    name: no           # a word, as it looks
    weights: {S1: 1e-3, S2: .5, S3: 010, S4: +1}
    fixed: {P9: 5}
    date: 2024-01-01
    time: 1:30
    baseline: null
    nothing:
    hexadecimal: 0x1F
    quoted: "5"
    yes: true
    list:
      - 1
      - ~
    """
    assert read(tmp_path, text) == {
        "name": "no",
        "weights": {"S1": 0.001, "S2": 0.5, "S3": 10, "S4": 1},
        "fixed": {"P9": 5},
        "date": "2024-01-01",
        "time": "1:30",
        "baseline": None,
        "nothing": None,
        "hexadecimal": 31,
        "quoted": "5",
        "yes": True,
        "list": [1, None],
    }


@given(document=st.dictionaries(st.text(st.characters(codec="utf-8")), plain))
def test_json_is_read_as_it_is_meant(document: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> None:
    assert read(tmp_path_factory.mktemp("json"), json.dumps(document), "campaign.json") == document


words = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z", "N"]), max_size=10)
values: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**20), 10**20) | finite | words,
    lambda children: st.lists(children, max_size=4) | st.dictionaries(words, children, max_size=4),
    max_leaves=15,
)


@given(document=st.dictionaries(words, values, max_size=4))
def test_yaml_that_is_written_is_read_back(document: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> None:
    class NoAliases(yaml.SafeDumper):
        def ignore_aliases(self, _data: Any) -> bool:
            return True

    text = yaml.dump(document, Dumper=NoAliases, allow_unicode=True)
    assert read(tmp_path_factory.mktemp("yaml"), text) == document


def test_standard_input_is_read_as_what_it_looks_like(monkeypatch: pytest.MonkeyPatch) -> None:
    for content in (b'{"name":\t"a"}', b"name: a", b"{name: a}"):
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(content)))
        assert read_document("-") == {"name": "a"}


@pytest.mark.slow("nested")
@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("a: 1\na: 2\n", "line 2, column 1: the key a"),
        ("w: {S1: 1, S1: 2}\n", "line 1, column 12: the key S1"),
        ("a: [1, 2\nb: 3\n", "line 2, column 2"),
        ("a:\n\t- 1\n", "line 2, column 1"),
        ("a:\n  b: {c: 1}\n\n # d\n   e: 1\n", "line 5, column 4: this line is indented by 3 spaces, the line before it by 2"),
        ("a: [1]\n- b\n", "line 2, column 1: what begins here"),
        ("a: b\n   c: 1\n", "line 2, column 5: a second `: `"),
        ("a: &x [1]\nb: *x\n", "line 2, column 4: aliases"),
        ("a: !!python/object:os.system x\n", "line 1, column 4: the tag"),
        ("a: !!timestamp x\n", "the tag"),
        ("w: {S1: .nan}\n", "line 1, column 9: .nan"),
        ("w: {S1: 1e999}\n", "1e999"),
        ("w: " + "9" * 5000, "5000 digits"),
        ("1: 2\n", "the key 1"),
        ("? [1]\n: 2\n", "the key"),
        ("- 1\n", "a list"),
        ("just words\n", "just words, not an object"),
        ("", "null, not an object"),
        ("a: 1\n---\nb: 2\n", "line 2, column 1"),
        ("a: \x00", "special characters are not allowed"),
        (b"a: \xff\n", "byte 3"),
        ("a: " + "[" * 5000, "nested"),
        ("a: " + "[" * 40 + "]" * 40, "nested deeper than"),
        ('a: "\\uD800"\n', "surrogate"),
        ("a: " + "x" * LARGEST_FILE, "1,048,576 bytes"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_what_cannot_be_read_is_refused_with_its_place(tmp_path: Path, content: str | bytes, said: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        read(tmp_path, content)
    assert said in str(caught.value)
    assert str(tmp_path / "campaign.yaml") in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_one_value_too_many_is_refused_with_its_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A megabyte of `1,` kept the server for 40 s."""
    monkeypatch.setattr(strict_json, "MOST_VALUES", 6)
    assert read(tmp_path, "a: [1, 2]\nb:\n  c: 3\n") == {"a": [1, 2], "b": {"c": 3}}
    with pytest.raises(InvalidInputError, match=r"line 4, column 4: the document has more than 6 values"):
        read(tmp_path, "a: [1, 2]\nb:\n  c: 3\nd: [\n4]\n")


def test_json_faults_are_refused_with_their_place(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"campaign\.json: .*line 2"):
        read(tmp_path, '{"a": 1,\n}', "campaign.json")
    with pytest.raises(InvalidInputError, match=r"campaign\.json: a\.b: NaN"):
        read(tmp_path, '{"a": {"b": NaN}}', "campaign.json")


def test_files_that_are_not_there_or_no_files_are_refused(tmp_path: Path) -> None:
    for file in (tmp_path / "nothing.yaml", tmp_path, Path("a\0b")):
        assert faulty_fields(read_document, str(file)) == [str(file)]


@pytest.mark.parametrize("name", ["campaign.yaml", "campaign.json"])
def test_faults_that_a_server_finds_get_their_file_and_line(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    file.write_text('{"name": "a",\n "weights": {"S1": 1,\n             "S9": 2},\n "optimizer": {}}')
    faults = InvalidInputError(*(Problem(field, "wrong", "") for field in ("weights.S9", "optimizer.kind", "", "fixed")))
    with pytest.raises(InvalidInputError) as refused, opened_document(str(file)):
        raise faults
    fields = [problem.field.removeprefix(f"{file}") for problem in refused.value.problems]
    assert fields == [": line 3: weights.S9", ": line 4: optimizer.kind", "", ": fixed"]
