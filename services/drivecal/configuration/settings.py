"""The settings of server and command line: flags, then `DRIVECAL_*` environment variables, then a config file, then defaults.

The config file is `drivecal.toml` in the working directory or `config.toml` in the home folder; what the first one says wins. It may have
come with other people's files: a file of another user, or that every user may write, is refused, and no secret from elsewhere goes to an
address that it names.

Unknown environment variables beginning with `DRIVECAL_` are ignored, because container platforms derive some from names of services. An
unknown key in a config file is refused.
"""

import os
import re
import stat
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import quote

from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    StringConstraints,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_settings import BaseSettings, InitSettingsSource, NoDecode, PydanticBaseSettingsSource, SettingsConfigDict

from drivecal.cluster.settings import host_and_port
from drivecal.contracts.strict_json import Identifier
from drivecal.domain.errors import InvalidInputError, Problem

PREFIX = "DRIVECAL_"
CONFIG_FILE = Path("drivecal.toml")
MOST_WORKERS = 10_000
DESTINATIONS = {"token": "url", "database_password_file": "database_url"}
"""Secrets, and the settings that say where each is sent."""
_PASSWORD = re.compile(r":[^/@]*@")

Line = Annotated[str, StringConstraints(min_length=1, max_length=4096, pattern=r"^[^\x00-\x1f\x7f]+$")]
Secret = Annotated[str, StringConstraints(min_length=1, max_length=4096, pattern=r"^[\x21-\x7e]+$")]
"""Printable ASCII without blanks, as in an HTTP header."""


def _counted(value: object) -> object:
    """Returns numbers by name; a text lists them as `carmaker=4,vtd=2`."""
    if not isinstance(value, str):
        return value
    entries = [entry.partition("=") for entry in value.split(",") if entry.strip()]
    if len({key.strip() for key, *_ in entries}) < len(entries) or not all(count.strip().isdecimal() for *_, count in entries):
        raise ValueError("give a whole number for each name once, such as carmaker=4,vtd=2")
    return {name.strip(): int(count) for name, _, count in entries}


Counts = Annotated[
    dict[Identifier, Annotated[int, Field(ge=0, le=100_000)]],
    NoDecode,
    BeforeValidator(_counted),
    PlainSerializer(lambda counts: ",".join(f"{name}={count}" for name, count in counts.items()), when_used="json"),
]
"""Numbers by name."""


class Settings(BaseSettings):
    """Settings, made by `load_settings`."""

    model_config = SettingsConfigDict(env_prefix=PREFIX, env_ignore_empty=True, extra="forbid", frozen=True)

    home: Path = Path(".drivecal")
    """Folder of drivecal's files: the SQLite database, the config file, the demo's results. Absolute once loaded."""
    database_url: Line = ""
    """SQLAlchemy URL; the default is the SQLite file `drivecal.db` in `home`."""
    database_password_file: Path | None = None
    """A file with the password that belongs into `database_url`, so that no environment shows it."""
    url: Line = "http://127.0.0.1:8000"
    """Address of the server for clients."""
    token: Secret | None = Field(default=None, repr=False)
    """Token of clients."""
    tokens_file: Path | None = None
    """The [tokens file](../how-to/tokens.md). Without it the server serves all users of this machine only."""
    queued_campaigns: Annotated[int, Field(ge=1, le=1_000_000)] = 1000
    """Largest number of waiting campaigns and evaluations; further ones are refused (429)."""
    largest_campaign: Annotated[int, Field(ge=1, le=10**12)] = 10_000_000
    """Cells that one campaign may propose, including its sensitivity analysis, before it is refused (413)."""
    pushed_problems: Annotated[int, Field(ge=1, le=1_000_000)] = 1000
    """Pushed problems that are kept before further ones are refused (413); each content counts."""
    problem_mb: Annotated[int, Field(ge=1, le=64)] = 64
    """Largest size of a pushed problem in megabytes, packed and unpacked; workers take no larger ones."""
    allow_push: bool | None = None
    """True if problems, which carry code, may be pushed; if it is left out, on loopback addresses only."""
    event_streams: Annotated[int, Field(ge=1, le=10_000)] = 100
    """Largest number of open event streams and pages; further ones are refused (429)."""
    backend: Literal["ray", "processes"] | None = None
    """Kind of the workers: processes of Ray, or plain ones of this machine; none: Ray if it is installed."""
    ray_address: Line | None = None
    """Address of a Ray cluster; without it the dispatcher starts a local Ray."""
    workers: Annotated[int, Field(ge=1, le=MOST_WORKERS)] | None = None
    """Simulations at a time; none: one per CPU, within the quota of a container."""
    resources: Counts = Field(default_factory=dict)
    """Licences and other scarce things that all runs of this server share, by name, as `carmaker=4,vtd=2`: see
    [resources](../how-to/resources.md)."""
    webhook: Annotated[Line, Field(pattern=r"^https?://[^/@\s]+(/|$)")] | None = Field(default=None, repr=False)
    """Address to which the dispatcher [posts](../how-to/monitoring.md#webhooks) that a campaign ended, stalled, or is degraded."""
    log_format: Literal["text", "json"] = "text"
    """Format of the server's log: readable lines, or a JSON document per line."""
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    running_campaigns: Annotated[int, Field(ge=1, le=1000)] = 8
    """Campaigns at a time. Of the others, a higher priority starts first, then the older one. Single evaluations do not count."""

    @field_validator("home", "tokens_file", "database_password_file")
    @classmethod
    def _absolute(cls, value: Path | None) -> Path | None:
        return None if value is None else value.expanduser().absolute()

    @model_validator(mode="before")
    @classmethod
    def _database_in_home(cls, values: dict[str, Any]) -> dict[str, Any]:
        if values.get("database_url"):
            url, file = str(values["database_url"]), values.get("database_password_file")
            if not file or url.startswith("sqlite"):  # a file needs none
                return values
            return {**values, "database_url": _with_password(url, Path(str(file)))}
        home = Path(str(values.get("home") or cls.model_fields["home"].default))
        return {**values, "database_url": f"sqlite:///{quote(str(home.expanduser().absolute() / 'drivecal.db'))}"}

    @field_validator("ray_address")
    @classmethod
    def _of_ray(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value is not None and info.data.get("backend") == "processes":
            raise ValueError("processes run on this machine only; leave the address out, or the backend")
        if value is not None:
            host_and_port(value)
        return value

    @field_validator("url")
    @classmethod
    def _web_address(cls, value: str) -> str:
        if not value.startswith(("http://", "https://")):
            raise ValueError("it is not a web address; give e.g. http://127.0.0.1:8000")
        return value

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Flags, environment, config file; secrets and dotenv files are not read."""
        del dotenv_settings, file_secret_settings
        here = _read(CONFIG_FILE)
        home = Path(str(init_settings().get("home") or env_settings().get("home") or here.get("home") or ".drivecal"))
        at_home = _read(home.expanduser() / "config.toml")
        if "home" in at_home:
            message = f"{home / 'config.toml'} lies in the home folder and cannot move it"
            raise InvalidInputError(Problem("home", message, "set DRIVECAL_HOME instead"))
        given = init_settings() | env_settings()
        trusted = {name: value for name, value in at_home.items() if "home" in given and name not in here}
        _refuse_to_send(given, trusted, here | at_home)
        return init_settings, env_settings, InitSettingsSource(settings_cls, at_home | here)

    @property
    def environment(self) -> dict[str, str]:
        """The settings as environment variables for the server's processes, without a client's token and a password from a file."""
        values = self.model_dump(mode="json", exclude_none=True, exclude={"token"})
        if self.database_password_file is not None and not self.database_url.startswith("sqlite"):
            values["database_url"] = _PASSWORD.sub("@", self.database_url, count=1)
        return {f"{PREFIX}{name.upper()}": str(value) for name, value in values.items()}


def load_settings(**flags: Any) -> Settings:
    """Returns the settings in force. `flags`: None stands for a missing one. Raises InvalidInputError naming each faulty setting."""
    try:
        return Settings(**{name: value for name, value in flags.items() if value is not None})
    except RuntimeError as error:
        raise InvalidInputError(Problem("home", str(error), "write the path out")) from error
    except ValidationError as error:
        raise InvalidInputError(*(_explain(dict(problem)) for problem in error.errors(include_url=False))) from None


def _with_password(url: str, file: Path) -> str:
    """Returns the URL with the password in `file`. Raises InvalidInputError if either is unusable."""
    name = "database_password_file"
    try:
        password = file.expanduser().read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise InvalidInputError(Problem(name, f"{file} cannot be read: {reason}", "make it, or name another one")) from None
    if not password:
        raise InvalidInputError(Problem(name, f"{file} is empty", "write the database's password into it"))
    scheme, _, rest = url.partition("://")
    authority, slash, path = rest.partition("/")
    user, at, host = authority.rpartition("@")
    if not at or not user or ":" in user:
        remedy = "name a user and no password in DRIVECAL_DATABASE_URL, e.g. postgresql://user@host/database"
        raise InvalidInputError(Problem(name, "the password has no place in the database URL", remedy))
    return f"{scheme}://{user}:{quote(password, safe='')}@{host}{slash}{path}"


def _refuse_to_send(given: Mapping[str, Any], trusted: Mapping[str, Any], files: Mapping[str, Any]) -> None:
    """Raises InvalidInputError if a config file sends a secret that it does not hold to an address of its own.

    `given`: flags and environment; `trusted`: the config file of a home folder that these name; `files`: all config files.
    """
    for secret, place in DESTINATIONS.items():
        if secret in given.keys() | trusted.keys() and place in files.keys() - given.keys() - trusted.keys():
            message = f"a config file in this folder names the address, and your environment the {secret}, which would go there"
            raise InvalidInputError(Problem(place, message, f"if you trust it, set {PREFIX}{place.upper()} as well"))


def _read(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            _refuse_others(path, os.fstat(file.fileno()))
            return tomllib.load(file)
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError) as error:  # TOMLDecodeError and UnicodeDecodeError are ValueErrors
        problem = Problem(str(path), f"the config file cannot be read: {error}", "mend or remove it")
        raise InvalidInputError(problem) from None


def _refuse_others(path: Path, status: os.stat_result) -> None:
    """Raises InvalidInputError if another user could have written a config file: it decides what this user runs."""
    if not hasattr(os, "geteuid"):  # Windows
        return
    remedy = f"if it is yours, type: chown $USER {path} && chmod go-w {path}"
    if status.st_uid not in {0, os.geteuid()}:
        raise InvalidInputError(Problem(str(path), f"the config file belongs to another user (uid {status.st_uid})", remedy))
    if status.st_mode & stat.S_IWOTH:
        raise InvalidInputError(Problem(str(path), "every user may write to the config file", remedy))


def _explain(error: dict[str, Any]) -> Problem:
    name = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        return Problem(name, "there is no such setting", f"one of {', '.join(sorted(Settings.model_fields))}")
    # a secret never goes into a message
    given = "the value" if name in {"token", "webhook", "database_url"} or "@" in str(error["input"]) else repr(error["input"])
    reason = error["msg"].removeprefix("Value error, ").lower()
    return Problem(name, f"{given} does not fit: {reason}", f"it is set by flag, {PREFIX}{name.upper()} or config file")
