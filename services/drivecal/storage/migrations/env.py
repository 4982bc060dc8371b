"""Runs revisions on the connection that `drivecal.storage.engine.schema.upgrade` gives, inside its transaction."""

from alembic import context

from drivecal.storage.engine.schema import REVISION_TABLE
from drivecal.storage.engine.tables import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    version_table=REVISION_TABLE,
    render_as_batch=True,  # SQLite alters tables by copying them
    transactional_ddl=True,
)
with context.begin_transaction():
    context.run_migrations()
