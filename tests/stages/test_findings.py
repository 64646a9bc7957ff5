"""What is wrong with a bag is said by `map`, kept in its metrics, and shown on the page."""

import json

from tests.helpers.report_fakes import undrawn
from tests.studio.room_bag import write_bag
from turtlebag.datasets.bags.copying import into_mcap
from turtlebag.datasets.bags.doctor import examine
from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.source import open_bag
from turtlebag.pipeline.cli.main import main

TEXT = "/scan: 1 of 151 messages cannot be decoded; skipped"


def damaged(folder, source):
    """A copy of a bag whose last scan is cut short."""
    messages = list(open_bag(source).messages())
    last = next(message for message in reversed(messages) if message.topic.name == "/scan")
    with BagFolder(folder, custom={}) as out:
        copier = into_mcap(out)
        for message in [*messages, last._replace(data=last.data[:50])]:
            copier.write(message)
    return folder, last.log_time_ns * 1e-9


def test_findings_go_from_the_bag_to_the_terminal_the_metrics_and_the_page(tmp_path, capsys):
    bag, first_s = damaged(tmp_path / "bag", write_bag(tmp_path / "whole"))
    assert main(["map", str(bag), "--out", str(tmp_path / "map")]) == 0
    assert f"note: {TEXT}" in capsys.readouterr().err
    findings = json.loads((tmp_path / "map/metrics.json").read_text())["findings"]
    assert findings.pop(0)["kind"] == "sweep time"
    assert findings == [
        {
            "kind": "damaged messages",
            "severity": "error",
            "topic": "/scan",
            "count": 1,
            "first_s": first_s,
            "text": TEXT,
        }
    ]
    assert TEXT in [str(found) for found in examine(bag)]
    with undrawn():
        assert main(["report", str(tmp_path / "map"), "--out", str(tmp_path / "page"), "--no-animation"]) == 0
    page = (tmp_path / "page/index.html").read_text()
    assert f"<strong>error</strong>: {TEXT}" in page
    assert "findings.1" not in page
