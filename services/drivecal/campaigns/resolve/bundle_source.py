"""Stored bundles as specifications name them."""

from dataclasses import replace

from sqlalchemy import Connection

from drivecal.bundles.archives import files_digest
from drivecal.bundles.manifest import Manifest
from drivecal.campaigns.resolve.bundle_bench import Bundle, BundleSource
from drivecal.storage import bundles
from drivecal.storage.engine.database import Database

MOST_READ = 64
"""Bundles that a process keeps: their content never changes, and the digest of their files takes a look at all of them."""
_read: dict[str, Bundle] = {}


def stored_bundles(database: Database) -> BundleSource:
    """Returns a source that reads a database."""

    def find(name: str) -> Bundle:
        with database.read() as connection:
            return bundles_of(connection)(name)

    return find


def with_tools(source: BundleSource, tools: str | None) -> BundleSource:
    """Returns a source whose bundles know what their `probe` answers."""
    return source if tools is None else lambda name: replace(source(name), tools=tools)


def bundles_of(connection: Connection) -> BundleSource:
    """Returns a source that reads through a connection."""

    def find(name: str) -> Bundle:
        stored = bundles.named(connection, name)
        bundle = _read.get(stored.digest)
        if bundle is None:
            files = files_digest(bundles.archive(connection, stored.digest))
            bundle = Bundle(stored.digest, files, Manifest.model_validate(stored.manifest))
            if len(_read) >= MOST_READ:
                _read.clear()
            _read[stored.digest] = bundle
        return bundle

    return find
