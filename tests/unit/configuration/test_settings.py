import os
from pathlib import Path

import pytest
from sqlalchemy import make_url

from drivecal.configuration.settings import Settings, load_settings
from drivecal.domain.errors import InvalidInputError


@pytest.fixture(autouse=True)
def _empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in Settings.model_fields:
        monkeypatch.delenv(f"DRIVECAL_{name.upper()}", raising=False)


def test_the_database_lies_in_the_home_folder_unless_it_is_named(tmp_path: Path) -> None:
    assert load_settings().database_url == f"sqlite:///{tmp_path}/.drivecal/drivecal.db"
    assert load_settings(home="elsewhere").database_url == f"sqlite:///{tmp_path}/elsewhere/drivecal.db"
    assert load_settings(home="elsewhere", database_url="sqlite:///a.db").database_url == "sqlite:///a.db"
    assert make_url(load_settings(home="what?%20x").database_url).database == f"{tmp_path}/what?%20x/drivecal.db"


def test_flags_win_over_environment_and_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("DRIVECAL_HOME", str(home))
    (home / "config.toml").write_text("workers = 1\nray_address = 'at-home:1'\n")
    assert (load_settings().workers, load_settings().ray_address) == (1, "at-home:1")
    Path("drivecal.toml").write_text("workers = 2\n")
    assert (load_settings().workers, load_settings().ray_address) == (2, "at-home:1")
    monkeypatch.setenv("DRIVECAL_WORKERS", "3")
    assert load_settings().workers == 3
    assert load_settings(workers=4).workers == 4
    assert load_settings(workers=None).workers == 3


def test_the_file_here_may_move_the_home_folder_but_the_file_at_home_may_not(tmp_path: Path) -> None:
    Path("drivecal.toml").write_text("home = 'there'\n")
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "config.toml").write_text("workers = 5\n")
    assert load_settings().workers == 5
    (tmp_path / "there" / "config.toml").write_text("home = 'nowhere'\n")
    with pytest.raises(InvalidInputError, match="DRIVECAL_HOME"):
        load_settings()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"workers = ", "drivecal.toml: "),
        (b"\xff\xfe", "drivecal.toml: "),
        (b"worker = 2", "^worker: .*database_password_file, .*home, "),
        (b"workers = 0", "^workers: 0 .*1.*DRIVECAL_WORKERS"),
        (b"workers = 1e30", "workers: "),
        (b"url = 'localhost:8000'", "^url: 'localhost:8000'"),
        (b'ray_address = "a\\nb:1"', "ray_address: "),
        (b'ray_address = "head:http"', "^ray_address: 'head:http'"),
        (b'ray_address = "head:99999"', "^ray_address: 'head:99999'"),
        (b"home = 3", "home: "),
        (b"home = '~no such user/x'", "home: "),
        (b"webhook = 'http://me:s3cret@host/x'", "^webhook: the value"),
        (b"url = 'ftp://me:s3cret@host'", "^url: the value"),
    ],
)
def test_a_config_file_that_is_wrong_is_refused_with_the_setting(content: bytes, message: str) -> None:
    Path("drivecal.toml").write_bytes(content)
    with pytest.raises(InvalidInputError, match=message):
        load_settings()


@pytest.mark.parametrize("file", ["drivecal.toml", ".drivecal/config.toml"])
@pytest.mark.parametrize(
    ("secret", "place"),
    [("token", "url = 'http://elsewhere'"), ("database_password_file", "database_url = 'postgresql://me@elsewhere/drivecal'")],
)
def test_a_config_file_of_a_cloned_repository_gets_no_secret_of_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, secret: str, place: str
) -> None:
    (tmp_path / "secret").write_text("word")
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(place)
    name = place.partition(" ")[0]
    value = str(tmp_path / "secret")
    with monkeypatch.context() as patch:
        patch.setenv(f"DRIVECAL_{secret.upper()}", value)
        with pytest.raises(InvalidInputError, match=f"^{name}: .*DRIVECAL_{name.upper()}"):
            load_settings()
        patch.setenv(f"DRIVECAL_{name.upper()}", place.partition("'")[2].rstrip("'"))
        assert "elsewhere" in getattr(load_settings(), name)
    (tmp_path / file).write_text(f"{place}\n{secret} = '{value}'\n")
    assert "elsewhere" in getattr(load_settings(), name)


def test_a_secret_of_the_home_folder_goes_to_its_own_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("DRIVECAL_HOME", str(home))
    (home / "config.toml").write_text("token = 'mine'\nurl = 'http://mine'\n")
    assert load_settings().url == "http://mine"
    Path("drivecal.toml").write_text("url = 'http://elsewhere'")
    with pytest.raises(InvalidInputError, match=r"^url: "):
        load_settings()
    Path("drivecal.toml").write_text("url = 'http://elsewhere'\ntoken = 'theirs'")
    assert (load_settings().url, load_settings().token) == ("http://elsewhere", "theirs")


def test_a_config_file_that_others_could_have_written_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "drivecal.toml"
    file.write_text("workers = 2")
    file.chmod(0o666)
    with pytest.raises(InvalidInputError, match="chmod"):
        load_settings()
    file.chmod(0o664)
    assert load_settings().workers == 2


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_a_config_file_of_another_user_is_refused(tmp_path: Path) -> None:
    (tmp_path / "drivecal.toml").write_text("workers = 2")
    os.chown(tmp_path / "drivecal.toml", 12345, 12345)
    with pytest.raises(InvalidInputError, match="another user"):
        load_settings()


def test_a_config_file_that_is_a_folder_is_refused() -> None:
    Path("drivecal.toml").mkdir()
    with pytest.raises(InvalidInputError, match=r"drivecal\.toml"):
        load_settings()


def test_an_environment_variable_that_is_wrong_is_refused_and_an_empty_one_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVECAL_WORKERS", "many")
    with pytest.raises(InvalidInputError, match="DRIVECAL_WORKERS"):
        load_settings()
    monkeypatch.setenv("DRIVECAL_WORKERS", "")
    assert load_settings().workers is None


def test_the_token_shows_up_in_no_message(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "secret" not in repr(load_settings(token="secret"))
    monkeypatch.setenv("DRIVECAL_TOKEN", "secret\n\n")
    with pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "token") as caught:
        load_settings()
    assert "secret" not in str(caught.value)


def test_a_child_process_reads_the_same_settings_from_its_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = load_settings(home="somewhere", workers=3, tokens_file="tokens", url="https://example.org", allow_push=False)
    for name, value in settings.environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir("/")
    assert load_settings() == settings


def test_a_child_process_is_not_told_the_users_own_token() -> None:
    assert "DRIVECAL_TOKEN" not in load_settings(token="secret").environment


@pytest.mark.parametrize("token", ["a b", "é", "a\tb", ""])
def test_a_token_that_no_header_can_carry_is_refused(token: str) -> None:
    with pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "token"):
        load_settings(token=token)


def test_a_wrong_database_url_is_refused_without_its_password() -> None:
    with pytest.raises(InvalidInputError) as error:
        load_settings(database_url="postgresql://me:hunter2@db/drivecal\n")
    assert [problem.field for problem in error.value.problems] == ["database_url"]
    assert "hunter2" not in str(error.value)


def test_the_databases_password_may_lie_in_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "password").write_text("a/b@c d\n")
    monkeypatch.setenv("DRIVECAL_DATABASE_URL", "postgresql://me@db:5432/drivecal?sslmode=require")
    monkeypatch.setenv("DRIVECAL_DATABASE_PASSWORD_FILE", str(tmp_path / "password"))
    settings = load_settings()
    assert settings.database_url == "postgresql://me:a%2Fb%40c%20d@db:5432/drivecal?sslmode=require"
    assert settings.environment["DRIVECAL_DATABASE_URL"] == "postgresql://me@db:5432/drivecal?sslmode=require"
    assert settings.environment["DRIVECAL_DATABASE_PASSWORD_FILE"] == str(tmp_path / "password")


@pytest.mark.parametrize(
    ("url", "content", "message"),
    [
        ("postgresql://me@db/drivecal", None, "password .*No such file or directory"),
        ("postgresql://me@db/drivecal", b"\n", "password is empty"),
        ("postgresql://me@db/drivecal", b"\xff", "password .*text"),
        ("postgresql://me:known@db/drivecal", b"word", "database URL.*no password"),
        ("postgresql://db/drivecal", b"word", "database URL.*user"),
    ],
)
def test_a_missing_password_is_named_with_its_file(tmp_path: Path, url: str, content: bytes | None, message: str) -> None:
    if content is not None:
        (tmp_path / "password").write_bytes(content)
    with pytest.raises(InvalidInputError, match=message):
        load_settings(database_url=url, database_password_file=tmp_path / "password")
