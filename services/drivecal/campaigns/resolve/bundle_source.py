"""Stored bundles as specifications name them."""

from sqlalchemy import Connection

from drivecal.bundles.manifest import Manifest
from drivecal.campaigns.resolve.bundle_bench import Bundle, BundleSource
from drivecal.storage import bundles
from drivecal.storage.engine.database import Database


def stored_bundles(database: Database) -> BundleSource:
    """Returns a source that reads a database."""

    def find(name: str) -> Bundle:
        with database.read() as connection:
            return bundles_of(connection)(name)

    return find


def bundles_of(connection: Connection) -> BundleSource:
    """Returns a source that reads through a connection."""

    def find(name: str) -> Bundle:
        stored = bundles.find(connection, name)
        return Bundle(stored.digest, stored.files, Manifest.model_validate(stored.manifest))

    return find
