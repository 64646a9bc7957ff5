"""Campaigns as they run: failures, resuming, the table."""

import json
import logging
import time
import uuid
from pathlib import Path

import pytest

from tests.helpers.campaigns import CAMPAIGN, FAKES, UNDRAWN, fake, read_fake
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.output_rules import MARKER
from turtlebag.datasets.outputs import Output, sha256_text, sha256_tree, write_json
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.campaign.campaign_file import Campaign, load_campaign
from turtlebag.pipeline.campaign.case import Where, recipes, run_case
from turtlebag.pipeline.campaign.cases import Case, cases
from turtlebag.pipeline.campaign.store import Store
from turtlebag.pipeline.campaign.table import query
from turtlebag.pipeline.terminal.messages import set_verbosity, verbosity_kept

ROOT = Path(__file__).parents[2]


MISSPELT = """
name: small
factors: {size: [1, 2]}
stages: {make: "fake --size {size}"}
results: {good: "make:good", worse: "make:error.rsme", whole: "make:error", nothing: "make:nothing"}
"""


def test_a_result_that_no_case_has_is_an_error_that_names_it(tmp_path, caplog):
    from turtlebag.pipeline.campaign.sweep import sweep

    def run(asked, out):
        code = fake(asked, out)
        path = out.folder / "metrics.json"
        write_json(path, {**json.loads(path.read_text()), "nothing": None})
        return code

    file = tmp_path / "mine.yaml"
    file.write_text(MISSPELT)
    assert sweep(str(file), Output(tmp_path / "out"), run=run, read=read_fake, scheduler="threads") == 1
    errors = [record.message for record in caplog.records if record.levelname == "ERROR"]
    assert errors == [
        f"{file}: results.worse: no case has make:error.rsme; did you mean make:error.rmse?",
        f"{file}: results.whole: no case has make:error; did you mean make:error.rmse?",
    ]
    early = [record.message for record in caplog.records if "so far" in record.message]
    assert early[0] == "results.worse: no case has make:error.rsme; did you mean make:error.rmse? (so far)"
    assert len(early) == 2
    assert query(Store(str(tmp_path / "out")), "SELECT count(good) FROM runs") == (["count(good)"], [(2,)])
    file.write_text(MISSPELT.replace('worse: "make:error.rsme", whole: "make:error", ', ""))
    assert sweep(str(file), Output(tmp_path / "right"), run=run, read=read_fake, scheduler="threads") == 0


def row_of(tmp_path, run=fake, at=None, **factors):
    commands = {"make": ["fake", "--size", str(factors["size"]), "--seed", "2"]}
    requests = {stage: read_fake(words) for stage, words in commands.items()}
    wanted = {"results": {"error_m": "make:error.rmse"}, "keep": ["metrics.json"]}
    wanted = {"stages": {"make": "fake"}, **wanted, **(at or {})}
    campaign = Campaign(name="small", factors={"size": [1]}, **wanted)
    where = Where(Store(str(tmp_path)), Store(str(tmp_path / "outputs")), "")
    return run_case(Case("c", factors, commands, requests), campaign, where, run)[0]


def test_a_case_leaves_its_row_and_what_is_to_be_kept(tmp_path):
    row = row_of(tmp_path, size=2)
    assert row == {"case": "c", "size": 2, "failed": False, "error": "", "error_m": pytest.approx(0.204)}
    assert json.loads((tmp_path / "rows/c.json").read_text())["row"] == row
    assert [path.name for path in (tmp_path / "cases/c/make").iterdir()] == ["metrics.json"]


@pytest.mark.parametrize(("size", "reason"), [(98, "turtlebag: bad size 98"), (99, "RuntimeError: a defect")])
def test_a_case_that_breaks_says_why_and_has_no_numbers(tmp_path, size, reason):
    row = row_of(tmp_path, size=size)
    assert row["failed"]
    assert row["error"] == f"make: {reason}"
    assert row["error_m"] is None


@pytest.fixture(scope="module")
def scheduler():
    import distributed  # only here: every worker collects this file

    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.slow
def test_threads_that_are_quiet_do_not_hush_the_campaign(tmp_path, capfd):
    from turtlebag.pipeline.campaign.sweep import sweep

    (tmp_path / "campaign.yaml").write_text(UNDRAWN.replace("[1, 2, 3]", "[1, 98]"))
    with verbosity_kept():
        set_verbosity(0)
        assert (
            sweep(
                str(tmp_path / "campaign.yaml"),
                Output(tmp_path / "out"),
                **FAKES,
                scheduler="threads",
            )
            == 1
        )
    said = capfd.readouterr().err
    assert said.count("make: turtlebag: bad size 98\n") == 8
    assert said.endswith("16 cases, 8 failed\n")


def test_the_commands_of_every_case_are_checked_before_the_first_runs(tmp_path):
    from turtlebag.pipeline.campaign.sweep import sweep

    (tmp_path / "campaign.yaml").write_text(UNDRAWN.replace("--odd", "--od"))
    with pytest.raises(InputError, match=r"stages\.make: fake: unrecognized arguments: --od; did you mean"):
        sweep(str(tmp_path / "campaign.yaml"), Output(tmp_path / "out"), **FAKES)
    assert [path.name for path in tmp_path.iterdir()] == ["campaign.yaml"]


def test_a_scheduler_that_is_not_there_leaves_nothing(tmp_path):
    from turtlebag.pipeline.campaign.sweep import sweep

    (tmp_path / "campaign.yaml").write_text(CAMPAIGN)
    with pytest.raises(InputError, match="no scheduler answers there"):
        sweep(
            str(tmp_path / "campaign.yaml"),
            Output(tmp_path / "out"),
            **FAKES,
            scheduler="bananas",
        )
    assert [path.name for path in tmp_path.iterdir()] == ["campaign.yaml"]


@pytest.mark.slow
def test_a_campaign_runs_on_a_scheduler_and_fails_only_where_it_must(tmp_path, scheduler):
    from turtlebag.pipeline.campaign.sweep import sweep

    (tmp_path / "mine.yaml").write_text(CAMPAIGN.replace("[1, 2, 3]", "[1, 2, 99]"))
    assert (
        sweep(
            str(tmp_path / "mine.yaml"),
            Output(tmp_path / "out"),
            **FAKES,
            scheduler=scheduler,
        )
        == 1
    )
    names, rows = query(
        Store(str(tmp_path / "out")),
        "SELECT size, median(error_m) AS m, "
        "count(*) FILTER (failed) AS f FROM runs GROUP BY size ORDER BY size",
    )
    assert names == ["size", "m", "f"]
    assert rows == [(1, pytest.approx(0.1025), 0), (2, pytest.approx(0.205), 0), (99, None, 8)]
    page = (tmp_path / "out/index.html").read_text()
    assert "8 of them failed" in page
    assert "RuntimeError: a defect" in page
    assert "24 cases: 3 levels of size \u00d7 2 levels of kind \u00d7 4 seeds" in page
    assert "turtlebag sweep mine.yaml --out OUT" in page
    assert "What differs from size = 1<" in page
    assert "Paired with size = 1<" in page
    assert (
        "<strong>error</strong>: 2 10.2\u202fcm (10.2\u202fcm to 10.3\u202fcm); no clear difference for 99"
        in page
    )
    assert "Good over size, for each kind." in page
    assert page.count('<td class="clear"') == 1
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    pair = next(p for p in summary["pairs"] if p["level"] == 2 and p["result"] == "error_m")
    assert pair["difference"]["value"] == pytest.approx(0.1025)
    assert pair["difference"]["n"] == 8
    with pytest.raises(InputError, match=r"^--query: "):
        query(Store(str(tmp_path / "out")), "SELECT nothing FROM runs")


class Impatient(logging.Handler):
    """Someone who presses Ctrl-C when the fourth case has failed."""

    def __init__(self):
        super().__init__()
        self.failed = 0

    def emit(self, record):
        self.failed += "bad size 98" in record.getMessage()
        if self.failed == 4:
            raise KeyboardInterrupt


@pytest.mark.slow
def test_a_stopped_campaign_goes_on_and_ends_in_the_same_bytes(tmp_path, scheduler):
    from turtlebag.pipeline.campaign.sweep import sweep

    (tmp_path / "campaign.yaml").write_text(CAMPAIGN.replace("[1, 2, 3]", "[1, 2, 98]"))
    campaign = str(tmp_path / "campaign.yaml")
    assert sweep(campaign, Output(tmp_path / "whole"), **FAKES, scheduler=scheduler) == 1
    log = logging.getLogger("turtlebag")
    log.addHandler(impatient := Impatient())
    try:
        with pytest.raises(KeyboardInterrupt):
            sweep(campaign, Output(tmp_path / "parts"), **FAKES, scheduler=scheduler)
    finally:
        log.removeHandler(impatient)
    done = len(list((tmp_path / "parts.partial/rows").glob("*.json")))
    assert 4 <= done <= 24
    assert sweep(campaign, Output(tmp_path / "parts"), **FAKES, scheduler=scheduler) == 1
    assert sha256_tree(tmp_path / "parts") == sha256_tree(tmp_path / "whole")


@pytest.mark.slow
def test_a_shared_stage_runs_once_for_all_that_ask_the_same(tmp_path, scheduler):
    from turtlebag.pipeline.campaign.sweep import sweep

    ran = tmp_path / "ran"  # what is run goes to the workers as a copy: it counts in files
    ran.mkdir()

    def counted(asked, out):
        (ran / uuid.uuid4().hex).touch()
        return fake(asked, out)

    text = UNDRAWN.replace("--seed {seed} {kind}", "--seed {seed}").replace(
        "metrics.json", "metrics.json {kind}"
    )
    (tmp_path / "campaign.yaml").write_text(text)
    assert (
        sweep(
            str(tmp_path / "campaign.yaml"),
            Output(tmp_path / "alone"),
            run=counted,
            read=read_fake,
            scheduler=scheduler,
        )
        == 0
    )
    assert len(list(ran.iterdir())) == 2 * 24
    (tmp_path / "campaign.yaml").write_text(text + "shared: [make]\n")
    assert (
        sweep(
            str(tmp_path / "campaign.yaml"),
            Output(tmp_path / "together"),
            run=counted,
            read=read_fake,
            scheduler=scheduler,
        )
        == 0
    )
    assert len(list(ran.iterdir())) == 2 * 24 + 24 + 12
    rows = [(tmp_path / name / "summary.json").read_bytes() for name in ("alone", "together")]
    assert rows[0] == rows[1]
    shared = list((tmp_path / "together/shared").iterdir())
    assert len(shared) == 12
    assert {path.name for path in shared[0].iterdir()} == {"metrics.json", "manifest.json"}
    assert not (tmp_path / "together/outputs").exists()


def test_without_a_terminal_a_line_a_minute_says_how_much_is_left(monkeypatch, caplog):
    from turtlebag.pipeline.campaign.sweep import with_time_left

    now_s = [0.0]

    def found():
        for case, took_s in (("a", 600.0), ("b", 59.0), ("c", 61.0)):
            now_s[0] += took_s
            yield {"case": case}, took_s

    monkeypatch.setattr(time, "perf_counter", lambda: now_s[0])
    with caplog.at_level("INFO", logger="turtlebag"):
        assert [row["case"] for row, _ in with_time_left(found(), 4)] == ["a", "b", "c"]
    assert caplog.messages == ["1 of 4 cases, about 30 min left", "3 of 4 cases, about 4 min left"]


def test_another_campaigns_leftovers_are_not_mixed_in(tmp_path, scheduler):
    from turtlebag.pipeline.campaign.sweep import sweep

    (tmp_path / "out.partial").mkdir()
    (tmp_path / "out.partial" / MARKER).write_text("turtlebag\n")
    (tmp_path / "out.partial/config.yaml").write_text("name: other\n")
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN)
    with pytest.raises(InputError, match="another campaign"):
        sweep(
            str(tmp_path / "campaign.yaml"),
            Output(tmp_path / "out"),
            **FAKES,
            scheduler=scheduler,
        )


@pytest.mark.slow
def test_rows_of_other_code_are_not_gone_on_with(tmp_path, scheduler):
    from turtlebag.pipeline.campaign import sweep

    (tmp_path / "campaign.yaml").write_text(UNDRAWN)
    file, out = str(tmp_path / "campaign.yaml"), tmp_path / "out"
    before = tmp_path / "out.partial"
    for name, text in {
        MARKER: "turtlebag\n",
        "config.yaml": config_text(load_campaign(file)),
        sweep.MARK: "of yesterday\n",
        "rows/old.json": "old",
    }.items():
        (before / name).parent.mkdir(parents=True, exist_ok=True)
        (before / name).write_text(text)
    with pytest.raises(InputError, match=r"other code.*--force"):
        sweep.sweep(file, Output(out), **FAKES, scheduler=scheduler)
    assert (tmp_path / "out.partial/rows/old.json").exists()
    assert sweep.sweep(file, Output(out, force=True), **FAKES, scheduler=scheduler) == 0
    assert not (out / "rows").exists()
    assert not (out / sweep.MARK).exists()


@pytest.mark.slow
def test_the_manifest_of_a_sweep_names_the_campaign_and_the_files_its_stages_read(tmp_path, scheduler):
    from turtlebag.pipeline.campaign.sweep import sweep

    (tmp_path / "own.yaml").write_text("a: 1\n")
    text = UNDRAWN.replace("--odd 'two words'", f"--world={tmp_path}/own.yaml:gate=open")
    (tmp_path / "campaign.yaml").write_text(text)
    assert (
        sweep(
            str(tmp_path / "campaign.yaml"),
            Output(tmp_path / "out"),
            **FAKES,
            scheduler=scheduler,
        )
        == 0
    )
    inputs = json.loads((tmp_path / "out/manifest.json").read_text())["inputs"]
    assert inputs["campaign"]["sha256"] == {"campaign.yaml": sha256_text(text)}
    assert inputs[str(tmp_path / "own.yaml")]["sha256"] == {"own.yaml": sha256_text("a: 1\n")}


def test_a_stage_may_have_nothing_to_do_and_an_output_not_depend_on_the_seed(tmp_path):
    campaign = load_campaign(str(ROOT / "benchmarks/front_ends.yaml"))
    found = cases(campaign)
    assert len(found) == 10 * 5 * 3
    public = [case for case in found if case.factors["log"] == "intel"]
    assert all(list(case.commands) == ["map"] for case in public)
    assert len({recipes(case, "")["map"] for case in public}) == 3
    driven = [case for case in found if case.factors["log"] == "maze tour"]
    assert driven[3].commands["drive"][:3] == ["record", "--world", "maze:2"]
    assert len({recipes(case, "")["map"] for case in driven}) == 15
    assert len({recipes(case, "")["drive"] for case in driven}) == 5
    row = row_of(tmp_path, size=2, at={"stages": {"make": "fake", "more": ""}, "results": {"r": "more:r"}})
    assert (row["failed"], row["r"]) == (False, None)
