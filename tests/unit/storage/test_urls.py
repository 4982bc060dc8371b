from pathlib import Path

import pytest

from drivecal.domain.errors import DatabaseError
from drivecal.storage.engine import urls


@pytest.mark.parametrize(
    ("given", "driver"),
    [
        ("sqlite:////data/drivecal.db", "sqlite+pysqlite"),
        ("sqlite:///drivecal.db", "sqlite+pysqlite"),
        ("postgresql://me:secret@host/db", "postgresql+psycopg"),
        ("postgres://me:secret@host/db", "postgresql+psycopg"),
        ("postgresql+psycopg2://me@host/db", "postgresql+psycopg"),
        ("postgresql:///db?host=/run/postgresql", "postgresql+psycopg"),
    ],
)
def test_urls_of_both_backends_get_the_driver_that_drivecal_brings(given: str, driver: str) -> None:
    parsed = urls.parse(given)
    assert parsed.drivername == driver
    assert parsed.password in {None, "secret"}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        *((url, "sqlite:////home") for url in ("", "drivecal.db", "sqlite:", "://", "postgresql://me:s3cret@host:port/db")),
        *((f"{backend}://me:s3cret@host/db", f"'{backend}'") for backend in ("mysql", "oracle")),
        *((url, "SQLite") for url in ("sqlite://", "sqlite:///:memory:", "sqlite:///file:x?mode=memory&uri=true")),
    ],
)
def test_what_is_no_url_of_a_database_that_processes_share_is_refused_without_its_password(given: str, said: str) -> None:
    with pytest.raises(DatabaseError, match=said) as caught:
        urls.parse(given)
    assert "s3cret" not in str(caught.value)


def test_only_sqlite_has_a_file() -> None:
    assert urls.sqlite_file(urls.parse("sqlite:////data/drivecal.db")) == Path("/data/drivecal.db")
    assert urls.sqlite_file(urls.parse("postgresql://host/db")) is None


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("sqlite:////data/drivecal.db", "/data/drivecal.db"),
        ("postgres://me:s3cret@host:5433/db?sslmode=require", "postgresql://me:***@host:5433/db"),
        ("postgresql://host/db?user=me&password=s3cret", "postgresql://host/db"),
        ("postgresql:///db?host=/run/postgresql&password=s3cret", "postgresql:///db?host=%2Frun%2Fpostgresql"),
    ],
)
def test_messages_never_show_a_password(given: str, expected: str) -> None:
    assert urls.shown(urls.parse(given)) == expected


def test_links_to_a_file_name_one_database(tmp_path: Path) -> None:
    file, link = tmp_path / "drivecal.db", tmp_path / "link.db"
    link.symlink_to(file)
    assert [urls.sqlite_file(urls.parse(f"sqlite:///{path}")) for path in (file, link)] == [file.resolve()] * 2
