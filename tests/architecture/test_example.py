"""The example that explains every field of a campaign file names them all, and tells their defaults right."""

import re
from pathlib import Path
from typing import Any

import yaml

from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import (
    CampaignSpecification,
    OptimizerSpecification,
    ReductionSpecification,
    RobustnessSpecification,
    SensitivitySpecification,
    ValidationSpecification,
)
from drivecal.plugins import registry

TEXT = (Path(__file__).parents[2] / "deploy" / "examples" / "highway.yaml").read_text()


def test_every_field_of_a_campaign_is_there_and_those_that_are_commented_out_have_their_defaults() -> None:
    start = TEXT.index("# sensitivity:")
    given: dict[str, Any] = yaml.safe_load(TEXT[:start] + re.sub(r"^# ?", "", TEXT[start:], flags=re.MULTILINE))
    assert set(given) == set(CampaignSpecification.model_fields)
    whole = validated(CampaignSpecification, given | {"optimizer": None})
    for name, model in (
        ("reduction", ReductionSpecification),
        ("sensitivity", SensitivitySpecification),
        ("robustness", RobustnessSpecification),
        ("validation", ValidationSpecification),
    ):
        assert set(given[name]) == set(model.model_fields)
        assert getattr(whole, name) == model()


def test_every_built_in_optimizer_is_there_with_its_defaults() -> None:
    start = TEXT.index("optimizer:\n")
    block = TEXT[start : TEXT.index("\n\n", start)]
    shown = [yaml.safe_load(block)["optimizer"]]
    assert set(shown[0]) == {*registry.optimizer("surrogate").settings.model_fields, "start_sets", "start_results"}
    shown += map(yaml.safe_load, re.findall(r"\{kind: [^}]*\}", re.sub(r"\s+#\s+", " ", block)))
    assert {item["kind"] for item in shown} >= {"genetic", "swarm", "random"}
    for settings in shown[1:]:
        model = registry.optimizer(settings["kind"]).settings
        assert model.model_validate(settings) == model()
        assert set(settings) == set(model.model_fields) - set(OptimizerSpecification.model_fields) | {"kind"}
