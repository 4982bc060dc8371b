"""Names that users give, on the page."""

from pathlib import Path

from playwright.sync_api import expect
from sqlalchemy import update
from tests.browser.conftest import BUSY, Opening, leave
from tests.support.computed import ComputedBackend
from tests.support.runs import influenced, run, submit
from tests.support.server import serving

from drivecal.storage.engine.tables import campaigns

MARKUP = "<img src=x onerror='window.carriedOut = 1'><script>window.carriedOut = 1</script>"


def test_a_name_in_markup_is_shown_letter_by_letter(opening: Opening, tmp_path: Path) -> None:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api:
        campaign = run(api.database, submit(api.database), ComputedBackend(answer=influenced))
        with api.database.transaction() as connection:
            connection.execute(update(campaigns).values(name=MARKUP))
        page = opening(f"{api.url}/#/")
        views = ["", f"campaigns/{campaign.id}", f"campaigns/{campaign.id}/ranking", f"compare?ids={campaign.id},{campaign.id}"]
        for path in views:
            leave(page, f"{api.url}/")
            page.goto(f"{api.url}/#/{path}")
            expect(page.get_by_role("main").get_by_text(MARKUP).first).to_be_visible()
            expect(page.get_by_role("main")).not_to_contain_text(BUSY)
            expect(page.locator("img[src='x'], main script")).to_have_count(0)
            assert not page.evaluate("'carriedOut' in window")
        page.close()
