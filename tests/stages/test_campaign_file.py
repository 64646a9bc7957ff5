"""Campaign files: their cases, and the mistakes that are named."""

import pytest

from tests.helpers.campaigns import CAMPAIGN
from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.campaign.campaign_file import FOLDER, Campaign, load_campaign
from turtlebag.pipeline.campaign.case import recipes
from turtlebag.pipeline.campaign.cases import cases, with_places


def load(tmp_path, text=CAMPAIGN):
    (tmp_path / "campaign.yaml").write_text(text)
    return load_campaign(str(tmp_path / "campaign.yaml"))


def test_the_grid_has_every_combination_once(tmp_path):
    found = cases(load(tmp_path), list)
    assert len(found) == 24
    assert len({case.name for case in found}) == 24
    strange = next(case for case in found if case.factors["kind"] == "strange")
    assert strange.commands["make"][-2:] == ["--odd", "two words"]
    assert strange.commands["check"][-1] == "{make}/metrics.json"


def test_levels_can_be_scaled_and_can_name_each_other(tmp_path):
    text = CAMPAIGN.replace(
        "\"--odd 'two words'\"", '"--a={size:1-0.25*x} --b={size:0.1*x} --c={size:-2+0.5*x}"'
    )
    strange = next(case for case in cases(load(tmp_path, text), list) if case.factors["kind"] == "strange")
    assert strange.commands["make"][-3:] == ["--a=0.75", "--b=0.1", "--c=-1.5"]
    with pytest.raises(InputError, match="not of the form"):
        cases(load(tmp_path, text.replace("0.1*x", "x*x")), list)


def test_braces_that_name_no_stage_stay_as_they_are(tmp_path):
    text = CAMPAIGN.replace("\"--odd 'two words'\"", "\"--a={{b: {size}}} '{{'\"")
    found = [case for case in cases(load(tmp_path, text), list) if case.factors["kind"] == "strange"]
    assert found[0].commands["make"][-3:] == ["--a={b:", "1}", "{"]
    assert recipes(found[0], "")["make"] != recipes(found[4], "")["make"]
    text = "--a={b} { {make}/metrics.json {later}"
    assert with_places(text, {"make": tmp_path}) == f"--a={{b}} {{ {tmp_path}/metrics.json {{later}}"


def test_levels_can_stand_for_texts(tmp_path):
    text = CAMPAIGN.replace("\"--odd 'two words'\"", '"{size:--a [0, 0]|--b|--c [1]}"')
    found = [case for case in cases(load(tmp_path, text), list) if case.factors["kind"] == "strange"]
    assert found[0].commands["make"][-3:] == ["--a", "[0,", "0]"]
    assert [case.commands["make"][-1] for case in found[4::4]] == ["--b", "[1]"]
    with pytest.raises(InputError, match="no text for level 3"):
        cases(load(tmp_path, text.replace("|--c [1]", "")), list)


def test_cases_whose_commands_are_the_same_are_rows_of_their_own(tmp_path):
    text = CAMPAIGN.replace("\"--odd 'two words'\"", '"--b={size:0*x}"').replace(
        "--size {size} ", "--size 1 "
    )
    found = cases(load(tmp_path, text), list)
    assert found[0].commands == found[8].commands
    assert len({case.name for case in found}) == len(found) == 24


def test_draws_are_within_bounds_and_repeat_with_the_seed(tmp_path):
    text = CAMPAIGN.replace("size: [1, 2, 3]", "size: {low: 0.5, high: 2.0}")
    with pytest.raises(InputError, match="needs `sample`"):
        load(tmp_path, text)
    found = cases(load(tmp_path, text + "sample: 50\n"), list)
    sizes = [case.factors["size"] for case in found]
    assert len(sizes) == 50
    assert 0.5 <= min(sizes) < max(sizes) <= 2.0
    assert cases(load(tmp_path, text + "sample: 50\n"), list) == found
    assert cases(load(tmp_path, text + "sample: 50\nseed: 2\n"), list) != found


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fake --size {size} --seed", "fake --size {size} --out here --seed", "stages.make: --out is set by"),
        ("--odd 'two words'", "--odd '--out=x'", "factors.kind.strange: --out is set by the campaign"),
        ("compare: size", "compare: shape", "not a factor"),
        ('"make:error.rmse"', '"cook:error"', "expected STAGE:PATH"),
        ("{size} --seed", "{height} --seed", "{height} is neither a factor nor an earlier stage"),
        ("{size} --seed", "{size.wide} --seed", "stages.make: .* no attribute 'wide'"),
        ("{size} --seed", "{size} {} --seed", "stages.make: a brace without a name"),
        ("  make: ", "  ../make: ", r"stages\.\.\./make"),
        ("y: good", "y: bad", "not a result"),
        ("question:", "questoin:", "unknown key"),
        ("compare: size", "shared: [cook]", "cook is not a stage"),
        ("unit: cm", "unit: inch", "unit inch: unknown; known: "),
        ("panels: kind", "panels: colour", "colour is not a factor"),
        ("size: [1, 2, 3]", "size: []", "factors.size: has no levels"),
        ("size: [1, 2, 3]", "size: [1, 2, '1']", "factors.size: level 1 is given twice"),
        ("size: [1, 2, 3]", "size: [null]", "campaign.yaml: factors.size: expected a list of values, "),
        ("{first: 1, last: 4}", "{first: 1, last: x}", "campaign.yaml: factors.seed: expected "),
        ("{first: 1, last: 4}", "{first: 4, last: 1}", "factors.seed: first 4 is after last 1"),
        ("against: 1", "against: 4", "against: 4 is not a level of size"),
        ("  seed: {first", "  error: [1]\n  seed: {first", "factors.error: the table has a column"),
        ("  seed: {first", "  case: [1]\n  seed: {first", "factors.case: the table has a column"),
        (' good: "check', ' failed: "check', "results.failed: the table has a column"),
        (' good: "check', ' size: "check', "size is both a factor and a result"),
        ("  seed: {first", "  run: [1, 2]\n  seed: {first", "factors.run: no stage uses it"),
        ('/metrics.json"', "/metrics.json 'x\"", "stages.check: .* 'x`: no closing quotation"),
    ],
)
def test_mistakes_in_a_campaign_are_named(tmp_path, old, new, message):
    assert old in CAMPAIGN
    with pytest.raises(InputError, match=message):
        cases(load(tmp_path, CAMPAIGN.replace(old, new)), list)


def test_a_session_that_a_person_would_drive_is_refused_before_the_first_case(tmp_path):
    (tmp_path / "live.yaml").write_text(
        "name: live\nquestion: Who drives?\nfactors: {seed: [1, 2]}\n"
        "stages: {drive: 'studio --world empty --seed {seed}'}\nresults: {time: drive:time_s}\n"
    )
    with pytest.raises(InputError, match=r"^stages\.drive: studio: a person drives; give --replay"):
        cases(load_campaign(str(tmp_path / "live.yaml")))


def test_every_shipped_study_can_be_expanded():
    for path in FOLDER.glob("*.yaml"):
        campaign = load_campaign(path.stem)
        assert campaign.name == path.stem
        assert len(cases(campaign)) > 1


def test_a_campaign_needs_its_keys():
    with pytest.raises(ValueError, match="stages"):
        Campaign.model_validate({"name": "x", "factors": {}, "results": {}})
