"""Campaigns over bags: patterns, a row for each bag, and everything in a store."""

import json
import math
import time
import uuid
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated

import distributed
import fsspec
import pytest

from tests.helpers.bag_samples import write_drive
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output, write_json, write_manifest
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.campaign.bags import bags_below, find_bags
from turtlebag.pipeline.campaign.campaign_file import load_campaign
from turtlebag.pipeline.campaign.case import Where, made_once, row_of
from turtlebag.pipeline.campaign.cases import cases
from turtlebag.pipeline.campaign.store import Store
from turtlebag.pipeline.campaign.table import query, write_table
from turtlebag.pipeline.campaign.worst import worst_case
from turtlebag.pipeline.stages.command_line import read
from turtlebag.pipeline.stages.requests.options import Option
from turtlebag.pipeline.stages.requests.request import Request

CAMPAIGN = """
name: fleet
bags: ["{at}/runs/*.mcap", "{at}/drive", "{at}/gone.mcap"]
factors: {{way: [1, 2]}}
stages:
  count: "count {{bag}}"
  map: "count {{bag}} --of {{count}}/metrics.json --way {{way}}"
results: {{scans: "map:scans"}}
shared: [count]
compare: way
against: 1
"""


class Count(Request):
    """What is asked of a stage that reads a bag."""

    VERB = "count"
    EXAMPLE = "turtlebag count BAG --out out"

    bag: Annotated[Path, Option("BAG", "bag", "rec", read=Path, positional=True)]
    of: Annotated[Path | None, Option("FILE", "an earlier count", "metrics.json", read=Path)] = None
    way: Annotated[int, Option("N", "which way", "1", read=int)] = 0


read_count = partial(read, kinds={"count": Count})


def count_scans(asked, output):
    """Stands in for the stages: one that reads a bag."""
    out = output.folder
    scans = len(load_recording(asked.bag))
    out.mkdir(parents=True)
    write_json(out / "metrics.json", {"scans": scans})
    write_manifest(out, stage="count", command=[], inputs={}, seed=None, wall_s=0.0)
    return 0


@pytest.fixture(scope="module")
def s3():
    """An S3 server on this machine."""
    server = pytest.importorskip(
        "moto.server", reason="no S3 server: pip install 'moto[s3]' flask flask-cors"
    )
    pytest.importorskip("s3fs", reason="no s3fs: pip install s3fs")
    served = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    served.start()
    yield "http://{}:{}".format(*served.get_host_and_port())
    served.stop()


@pytest.fixture(params=["folder", "memory", "s3"])
def place(request, tmp_path, monkeypatch):
    """The URL of an empty place: a folder, memory, or a bucket."""
    name = f"place-{uuid.uuid4().hex[:8]}"
    if request.param == "folder":
        return str(tmp_path / name)
    if request.param == "memory":
        return f"memory://{name}"
    monkeypatch.setenv("AWS_ENDPOINT_URL", request.getfixturevalue("s3"))
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "a")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "b")
    fsspec.filesystem("s3", use_listings_cache=False).mkdir(name)
    return f"s3://{name}"


def test_an_object_is_put_whole(place):
    store = Store(place).below("part")
    store.put("a/b", b"first")
    assert store.read("a/b") == b"first"
    store.put("a/b", b"third")
    assert list(store.read_all(store.names("a"))) == [b"third"]
    assert store.read("a/c") is None
    assert (store.has("a/b"), store.has("a/c")) == (True, False)
    assert store.names("a") == ["a/b"]
    assert store.names("nothing") == []
    store.delete("a/b")
    store.delete("a/b")
    store.delete_below("a")
    assert store.names("a") == []


@pytest.fixture
def cluster():
    """Four workers in this process."""
    with distributed.Client(n_workers=4, threads_per_worker=1, processes=False, dashboard_address=None) as it:
        yield it


def test_what_many_want_is_made_by_one(place, cluster, tmp_path):
    store, made = Store(place), tmp_path / "made"

    def make():
        with made.open("a") as file:
            file.write("x")
        time.sleep(0.3)
        return b"made"

    wanting = [cluster.submit(made_once, store, "it", make, pure=False) for _ in range(4)]
    assert cluster.gather(wanting) == [b"made"] * 4
    assert made_once(store, "it", make) == b"made"
    assert made.read_text() == "x"


def test_who_fails_gives_the_lock_up(tmp_path, cluster):
    def broken():
        raise RuntimeError("a defect")

    store = Store(str(tmp_path))
    with pytest.raises(RuntimeError):
        made_once(store, "it", broken)
    assert made_once(store, "it", lambda: b"made") == b"made"


def test_a_table_is_a_file_for_each_level_and_whole_only_with_its_index(place):
    store = Store(place)
    rows = [{"case": str(k), "rate": 0.25 * (k % 3), "good": k % 2 == 0, "why": None} for k in range(9)]
    for partition in ("good", "rate"):
        write_table(rows, partition, store)
    assert store.names("results") == [
        f"results/rate={rate}/data_0.parquet" for rate in ("0.0", "0.25", "0.5")
    ]
    sql = "SELECT rate, count(*) FILTER (good) FROM runs WHERE rate > 0 GROUP BY rate ORDER BY rate"
    assert query(store, sql)[1] == [(0.25, 1), (0.5, 2)]
    assert query(store, "SELECT * FROM runs")[0] == ["case", "rate", "good", "why"]
    store.delete("results.json")
    with pytest.raises(InputError, match="not a finished campaign"):
        query(store, sql)


def upload(place, tmp_path):
    """Two bags, a record's folder and a file that is none, below the place."""
    write_drive(tmp_path / "drive/bag", seconds=2.0)
    mcap = (tmp_path / "drive/bag/bag_0.mcap").read_bytes()
    store = Store(place)
    for name in ("runs/a.mcap", "runs/b.mcap", "drive/bag/bag_0.mcap"):
        store.put(name, mcap)
    store.put("drive/bag/metadata.yaml", (tmp_path / "drive/bag/metadata.yaml").read_bytes())
    store.put("runs/c.mcap", b"no bag at all")


def test_patterns_name_bags(place, tmp_path):
    upload(place, tmp_path)
    at = Store(place)
    root = place if at.is_local else at.files.unstrip_protocol(at.at("")[:-1])

    def names(*patterns):
        return [url.removeprefix(root) for url in find_bags([f"{place}/{pattern}" for pattern in patterns])]

    assert names("runs/*.mcap") == ["/runs/a.mcap", "/runs/b.mcap", "/runs/c.mcap"]
    assert names("runs", "drive") == ["/runs/a.mcap", "/runs/b.mcap", "/runs/c.mcap", "/drive"]
    assert names("*") == ["/drive", "/runs/a.mcap", "/runs/b.mcap", "/runs/c.mcap"]
    assert find_bags([f"{place}/gone.mcap"]) == {f"{place}/gone.mcap": ""}
    with pytest.raises(InputError, match=r"bags: .*/\*\.bag: no bag or log matches it"):
        names("*.bag")
    first = find_bags([f"{place}/drive", f"{place}/runs/a.mcap"])
    at.put("drive/bag/bag_0.mcap", b"another")
    second = find_bags([f"{place}/drive", f"{place}/runs/a.mcap"])
    assert [first[url] == second[url] for url in first] == [False, True]


@pytest.mark.parametrize("folder", ["", "/a//drive"])
def test_a_bag_is_one_also_at_the_top_of_a_store_and_below_a_folder_without_a_name(folder):
    files = {f"{folder}/{name}": {"size": 1, "mtime": 1} for name in ("metadata.yaml", "bag_0.mcap")}
    store = SimpleNamespace(find=lambda top, detail: files)
    assert [*bags_below(store, "")] == [folder]


@pytest.mark.slow
def test_every_bag_is_a_row_and_the_store_holds_all(place, tmp_path):
    from turtlebag.pipeline.campaign.sweep import sweep

    upload(place, tmp_path)
    (tmp_path / "fleet.yaml").write_text(CAMPAIGN.format(at=place))
    ran = tmp_path / "ran"  # what is run goes to the workers as a copy: it counts in files
    ran.mkdir()

    def counted(asked, out):
        (ran / uuid.uuid4().hex).touch()
        return count_scans(asked, out)

    def run(out):
        options = {"store": f"{place}/campaigns", "scheduler": "threads", "workers": 3}
        return sweep(
            str(tmp_path / "fleet.yaml"), Output(tmp_path / out), run=counted, read=read_count, **options
        )

    assert run("out") == 1
    store = Store(f"{place}/campaigns/fleet")
    sql = "SELECT parse_filename(bag) AS b, way, scans, error FROM runs ORDER BY b, way"
    rows = query(store, sql)[1]
    scans = len(load_recording(tmp_path / "drive"))
    assert [(b, way, scans) for b, way, *_ in rows if b in ("a.mcap", "b.mcap", "drive")] == [
        row[:3] for row in rows if row[2] is not None
    ]
    failed = {b: error for b, _, scans, error in rows if scans is None}
    assert set(failed) == {"c.mcap", "gone.mcap"}
    assert "count: turtlebag: " in failed["c.mcap"]
    assert "/runs/c.mcap: damaged bag" in failed["c.mcap"]
    assert failed["gone.mcap"].endswith("/gone.mcap: no such file or folder")
    shared = store.names("shared")
    assert len(shared) == 2 * 3
    assert "10 cases" in store.read("index.html").decode()
    base = f"file://{place}/campaigns/fleet" if place.startswith("/") else store.url
    assert f'href="{base}/cases/' in (tmp_path / "out/index.html").read_text()
    assert json.loads((tmp_path / "out/manifest.json").read_text())["store"] == store.url
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "config.yaml", "index.html", "manifest.json", "summary.json",
    }  # fmt: skip
    # The same again only reads; with a new bag in the bucket that one is run.
    before = len(list(ran.iterdir()))
    assert (
        before == 3 * 1 + 3 * 2 + (2 if place.startswith("/") else 0) + 2
    )  # the broken ones by each of both
    assert run("again") == 1
    assert len(list(ran.iterdir())) == before
    Store(place).put("runs/d.mcap", Store(place).read("runs/a.mcap"))
    assert run("more") == 1
    assert len(list(ran.iterdir())) == before + 3
    assert len(query(store, sql)[1]) == 12


def test_the_worst_case_is_the_first_with_the_largest_number(tmp_path):
    (tmp_path / "fleet.yaml").write_text(CAMPAIGN.format(at=tmp_path).replace("gone.mcap", "it.mcap"))
    for name in ("runs/a.mcap", "drive/x.bag"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).touch()
    campaign = load_campaign(str(tmp_path / "fleet.yaml"))
    todo, store = cases(campaign, read_count), Store(str(tmp_path / "out"))
    where = Where(store, store, "")
    values = [7, 9, None, True, 9, math.nan]
    rows = [row_of(case, campaign, "") | {"scans": n} for case, n in zip(todo, values, strict=True)]
    worst = worst_case(campaign, todo, rows, where)
    assert (worst.row, worst.value, worst.label) == (rows[1], 9, "scans")
    assert worst.link == f"cases/{todo[1].name}/map/metrics.json"
    assert worst_case(campaign, todo, rows[2:4], where) is None


def test_bags_are_a_factor_with_a_name_of_its_own(tmp_path):
    for old, new, message in [
        ("way: [1, 2]", "bag: [1], way: [1]", "factors.bag: `bags` already defines this factor"),
        ("{{bag}}", "x", "factors.bag: no stage uses it"),
        ("bags: [", "bag: [", "unknown key"),
    ]:
        (tmp_path / "fleet.yaml").write_text(CAMPAIGN.replace(old, new).format(at=tmp_path))
        with pytest.raises(InputError, match=message):
            cases(load_campaign(str(tmp_path / "fleet.yaml")), read_count)


def test_a_store_that_only_one_process_sees_needs_threads(tmp_path):
    from turtlebag.pipeline.campaign.sweep import sweep

    (tmp_path / "small.yaml").write_text(
        "name: s\nfactors: {k: [1]}\nstages: {a: 'count x --way {k}'}\nresults: {r: 'a:r'}"
    )
    with pytest.raises(InputError, match="add --scheduler threads"):
        sweep(
            str(tmp_path / "small.yaml"),
            Output(tmp_path / "out"),
            run=count_scans,
            read=read_count,
            store="memory://x",
        )
    with pytest.raises(InputError, match="Protocol not known"):
        sweep(
            str(tmp_path / "small.yaml"),
            Output(tmp_path / "out"),
            run=count_scans,
            read=read_count,
            store="nowhere://x",
        )
