from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps
from drivecal.storage.references.influence_maps import StoredInfluenceMap


def test_maps_are_listed_newest_first(database: Database) -> None:
    with database.transaction() as connection:
        for number in range(3):
            influence_maps.insert(
                connection, name=str(number), source="expert", driving_function="frenet", parameters="highway", scenarios={}
            )
    result: list[StoredInfluenceMap] = []
    cursor = None
    with database.read() as connection:
        while True:
            page, cursor = influence_maps.page(connection, limit=2, cursor=cursor)
            result.extend(page)
            if cursor is None:
                break
    assert [item.name for item in result] == ["2", "1", "0"]
