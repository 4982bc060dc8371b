"""The page next to a server of its own: followed live, asked for a token, gone and back."""

import json
import re
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect
from tests.browser.conftest import Opening, barriers
from tests.support.computed import ComputedBackend
from tests.support.runs import SMALL, WITH_ANALYSIS, dispatcher, get, influenced, run, submit
from tests.support.server import serving

from drivecal.bundles.archives import folder_digest
from drivecal.client.problem_templates import write_problem
from drivecal.storage import campaigns

pytestmark = pytest.mark.slow

TOKEN = "reader-0123456789abcdef"
TINY = {"kind": "genetic", "population": 6, "iterations": 2}


def test_a_campaign_is_followed_live(tmp_path: Path, opening: Opening) -> None:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api:
        campaign = submit(api.database, **SMALL)
        page = opening(f"{api.url}/#/campaigns/{campaign.id}")
        expect(page.get_by_text("Waiting for its turn.").first).to_be_visible()
        with api.database.transaction() as connection:
            campaigns.explain(connection, {campaign.sequence: "no worker is ready yet"})
        expect(page.get_by_text("no worker is ready yet")).to_be_visible()
        working = dispatcher(api.database)
        while get(api.database, campaign).cells.requested < 60:
            working.step()
        expect(page.get_by_text(re.compile(r"Searching: iteration \d"))).to_be_visible()
        expect(page.get_by_text("begins with the first sets")).to_be_visible()
        while not api.http.get(f"/api/v1/campaigns/{campaign.id}/generations").json()["items"]:
            working.step()
        course = page.get_by_role("img", name=re.compile("^Best score by simulations"))
        expect(course.locator("path").first).to_have_attribute("d", re.compile("^M.+L"))  # a mark, not an empty chart
        run(api.database, campaign)
        expect(page.get_by_text("Finished.")).to_be_visible()
        requested = get(api.database, campaign).cells.requested
        expect(page.get_by_role("img", name=f"{requested} requested")).to_be_visible()
        page.close()


def test_a_study_is_started_from_the_page_with_its_settings(tmp_path: Path, opening: Opening) -> None:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api:
        campaign = run(api.database, submit(api.database, **WITH_ANALYSIS), ComputedBackend(answer=influenced))
        page = opening(f"{api.url}/#/campaigns/{campaign.id}", expected=("422",))
        page.get_by_role("button", name="Robustness").click()
        cost = page.get_by_text(re.compile(r"At most [\d,]+ simulations"))
        expect(cost).to_be_visible()
        usual = cost.inner_text()
        page.get_by_text("Settings: defaults").click()
        page.get_by_label("steps").fill("0")
        expect(page.get_by_text("A setting is wrong")).to_be_visible()
        page.get_by_label("steps").fill("2")
        expect(cost).to_be_visible()
        expect(cost).not_to_have_text(usual)
        page.get_by_role("button", name="Validate the map").click()
        page.get_by_text("Settings: defaults").click()
        page.get_by_label("references").fill("7")
        page.get_by_role("button", name="Start the study").click()
        expect(page.get_by_role("heading", name="A validation")).to_be_visible()
        made = api.http.get(f"/api/v1/campaigns/{page.url.rpartition('/')[2]}").json()
        assert made["spec"]["optimizer"] is None
        assert made["spec"]["validation"]["references"] == 7
        assert made["spec"]["sensitivity"] == {"map": campaign.influence_map_id or get(api.database, campaign).influence_map_id}
        page.get_by_role("link", name="Campaigns", exact=True).click()
        rows = page.get_by_role("table").get_by_role("row")
        expect(rows.nth(2)).to_contain_text("test (validation)")
        expect(rows.nth(1)).to_contain_text(campaign.id[:8])
        page.close()


def test_campaigns_are_tagged_and_deleted_where_they_are_listed(tmp_path: Path, opening: Opening) -> None:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api:
        first, second = (run(api.database, submit(api.database, optimizer=TINY)) for _ in range(2))
        page = opening(f"{api.url}/#/", expected=("409",))
        ticked = page.get_by_role("group", name="Ticked campaigns")
        page.get_by_role("checkbox", name=first.id[:8]).check()
        ticked.get_by_label("Tag for the ticked campaigns").fill("good car-7")
        ticked.get_by_role("button", name="Add tag").click()
        page.get_by_role("group", name="Only with tags").get_by_role("button", name="car-7").click()
        boxes = page.get_by_role("table").get_by_role("checkbox")
        expect(boxes).to_have_count(1)
        assert barriers(page) == []
        page.get_by_role("group", name="Only with tags").get_by_role("button", name="car-7").click()
        expect(boxes).to_have_count(2)
        page.get_by_role("checkbox", name=first.id[:8]).uncheck()
        page.get_by_role("checkbox", name=second.id[:8]).check()
        ticked.get_by_role("button", name="Delete").click()
        ticked.get_by_role("button", name="Really delete").click()
        expect(boxes).to_have_count(1)
        assert api.http.get(f"/api/v1/campaigns/{second.id}").status_code == 404
        page.goto(f"{api.url}/#/campaigns/{first.id}")
        rerun = api.http.post(f"/api/v1/campaigns/{first.id}/rerun", json={"weights": {"S1": 2}}).json()["id"]
        page.get_by_role("button", name="Edit name and tags").click()
        page.get_by_role("button", name="Delete", exact=True).click()
        page.get_by_role("button", name="Really delete").click()
        expect(page.get_by_role("alert")).to_contain_text(rerun)
        assert api.http.get(f"/api/v1/campaigns/{first.id}").status_code == 200
        page.close()


def test_where_tokens_are_asked_for_the_page_asks_for_one_and_keeps_none(tmp_path: Path, opening: Opening) -> None:
    (tmp_path / "tokens").write_text(f"anna read {TOKEN}\nbert author {TOKEN[::-1]}\n")
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}", tokens_file=str(tmp_path / "tokens")) as api:
        campaign = run(api.database, submit(api.database, optimizer={"kind": "genetic", "population": 6, "iterations": 2}))
        page = opening(f"{api.url}/#/campaigns/{campaign.id}", expected=("401", "403", "422", "503"))
        assert barriers(page) == []
        page.get_by_label("Token", exact=True).fill("wrong-0123456789abcdef")
        page.get_by_role("button", name="Log in").click()
        expect(page.get_by_text("does not know this token")).to_be_visible()
        page.get_by_label("Token", exact=True).fill(TOKEN)
        page.get_by_role("button", name="Log in").click()
        expect(page.get_by_text("Finished.")).to_be_visible()
        expect(page.get_by_text("anna (may read)")).to_be_visible()
        page.reload()
        expect(page.get_by_text("Finished.")).to_be_visible()
        page.goto(f"{api.url}/#/evaluations/1")
        expect(page.get_by_text("Your token is read-only.")).to_be_visible()
        page.goto(f"{api.url}/#/submit")
        expect(page.get_by_text("may not start anything")).to_be_visible()
        expect(page.get_by_role("button", name="Start it")).to_have_count(0)
        page.get_by_role("button", name="Log out").click()
        page.get_by_label("Token", exact=True).fill(TOKEN[::-1])
        page.get_by_role("button", name="Log in").click()
        simulations = page.get_by_label("simulations")
        with page.expect_response(re.compile("validate_only")):
            simulations.fill("7")
        page.context.clear_cookies()  # the session ends
        simulations.fill("77")
        page.get_by_label("Token", exact=True).fill(TOKEN[::-1])
        page.get_by_role("button", name="Log in").click()
        expect(simulations).to_have_value("77")
        page.goto(f"{api.url}/#/problems")
        push_a_folder(page, tmp_path / "mine", "Your token again", TOKEN[::-1])
        assert (
            folder_digest(tmp_path / "mine")
            in api.http.get("/api/v1/problems/mine", headers={"Authorization": f"Bearer {TOKEN}"}).text
        )
        assert TOKEN[::-1] not in page.evaluate("JSON.stringify({...localStorage, ...sessionStorage}) + document.cookie")
        page.route("**/session", lambda route: route.fulfill(status=503, json={"detail": "away"}))
        page.get_by_role("button", name="Log out").click()
        expect(page.get_by_text("Logging out failed: away")).to_be_visible()
        page.unroute("**/session")
        page.get_by_role("button", name="Log out").click()
        expect(page.get_by_label("Token", exact=True)).to_be_visible()
        kept = page.evaluate("JSON.stringify([document.cookie, {...localStorage}, {...sessionStorage}])")
        assert json.loads(kept) == ["", {}, {}]
        page.reload()
        expect(page.get_by_label("Token", exact=True)).to_be_visible()
        page.close()


def test_without_tokens_a_dropped_problem_is_signed_by_the_secret_of_the_server(tmp_path: Path, opening: Opening) -> None:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}", home=str(tmp_path / "home")) as api:
        page = opening(f"{api.url}/#/problems", expected=("403", "422"))
        secret = Path(api.http.get("/api/v1/session").json()["signed_by"]).read_text()
        push_a_folder(page, tmp_path / "mine", "Content of push.secret", secret)
        assert barriers(page) == []
        choose_folder(page, tmp_path / "mine")
        page.get_by_label("Content of push.secret").fill(secret[::-1])
        page.get_by_role("button", name="Push", exact=True).click()
        expect(page.get_by_role("alert")).to_contain_text("push.secret")
        assert folder_digest(tmp_path / "mine") in api.http.get("/api/v1/problems/mine").text
        assert secret not in page.evaluate("JSON.stringify({...localStorage, ...sessionStorage}) + document.cookie")
        page.close()


def choose_folder(page: Page, folder: Path) -> None:
    page.get_by_label("a folder").set_input_files(folder)


def drop_folder(page: Page, folder: Path) -> None:
    """Drags a folder of this machine onto the page, as a user does from a file manager."""
    place = page.get_by_text("Drop the folder").bounding_box()
    assert place is not None
    session = page.context.new_cdp_session(page)
    dragged = {"items": [], "files": [str(folder)], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        session.send("Input.dispatchDragEvent", {"type": kind, "x": place["x"] + 5, "y": place["y"] + 5, "data": dragged})


def push_a_folder(page: Page, folder: Path, asked: str, proof: str) -> None:
    """Pushes a faulty folder, which is refused, and a mended one; the page asks for `asked` each time."""
    write_problem("process", "mine", str(folder))
    good = (folder / "problem.yaml").read_text()
    for give, text, said in (
        (choose_folder, good.replace(": minimise", ": down"), r"problem.yaml\d+scores.cost.direction"),
        (drop_folder, good, "mine is stored"),
    ):
        (folder / "problem.yaml").write_text(text)
        give(page, folder)
        page.get_by_label(asked).fill(proof)
        page.get_by_role("button", name="Push", exact=True).click()
        expect(page.get_by_role("main")).to_contain_text(re.compile(said))
