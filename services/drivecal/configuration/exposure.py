"""Addresses that the server may listen on: loopback only, unless it requires tokens."""

import ipaddress

from drivecal.configuration.settings import Settings
from drivecal.domain.errors import InvalidInputError, Problem

MAKE_TOKENS = "python3 -c 'import secrets; print(\"me write\", secrets.token_urlsafe(24))' > tokens"
"""The shortest way to a tokens file."""


def is_loopback(address: str) -> bool:
    """Returns True for an IP address that only this machine can connect to."""
    return ipaddress.ip_address(address.partition("%")[0]).is_loopback


def is_this_machine(name: str) -> bool:
    """Returns True for localhost and loopback addresses, False for all other names."""
    try:
        return name.lower() == "localhost" or is_loopback(name)
    except ValueError:
        return False


def check_exposure(address: str, settings: Settings) -> None:
    """Raises InvalidInputError if other machines could use a server without tokens."""
    if settings.tokens_file is None and not is_loopback(address):
        remedy = (
            f"make a tokens file ({MAKE_TOKENS}) and name it by --tokens-file or DRIVECAL_TOKENS_FILE, or listen on 127.0.0.1"
        )
        raise InvalidInputError(Problem("--host", f"everyone who reaches {address} could use this server", remedy))
