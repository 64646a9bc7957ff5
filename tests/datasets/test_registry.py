"""The registry of public logs: its descriptions are true, and it accepts no other file."""

import re
import shutil
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.registry import DATASETS, fetch, local_files
from turtlebag.pipeline.cli.main import main

SHARED = Path(__file__).parents[3] / "shared" / "data"
mirrored = pytest.mark.skipif(not (SHARED / "radish").is_dir(), reason="no mirror of the public logs here")


@pytest.fixture(autouse=True)
def _no_environment(monkeypatch, tmp_path):
    monkeypatch.delenv("TURTLEBAG_DATA", raising=False)
    monkeypatch.setenv("TURTLEBAG_CACHE", str(tmp_path / "cache"))


def test_every_entry_is_complete():
    for name, dataset in DATASETS.items():
        assert dataset.name == name
        assert dataset.license
        assert dataset.author
        assert bool(dataset.relations) == bool(dataset.scans)  # a log, or worlds
        for file in dataset.files:
            assert file.url.startswith("https://")
            assert re.fullmatch("[0-9a-f]{64}", file.sha256)


@mirrored
@pytest.mark.parametrize("folder", [SHARED, SHARED / "radish"])
def test_the_mirror_folder_is_used_in_place(monkeypatch, folder):
    monkeypatch.setenv("TURTLEBAG_DATA", str(folder))
    assert [path.name for path in fetch("intel")] == ["intel.clf.bz2", "intel.relations"]


@pytest.mark.slow
@mirrored
@pytest.mark.parametrize("name", ["fr079", "mit-csail"])
def test_the_facts_are_those_of_the_log(monkeypatch, name):
    monkeypatch.setenv("TURTLEBAG_DATA", str(SHARED))
    dataset, recording = DATASETS[name], load_recording(fetch(name)[0])
    assert recording.ranges.shape == (dataset.scans, dataset.beams)
    assert recording.T_base_lidar.x == dataset.laser_x_m
    assert any(f"readings of {dataset.no_return_m:g} m" in note for note in recording.notes)


def test_a_wrong_file_in_the_mirror_is_refused(monkeypatch, tmp_path, capsys):
    (tmp_path / "intel.clf.bz2").write_bytes(b"something else")
    monkeypatch.setenv("TURTLEBAG_DATA", str(tmp_path))
    assert main(["data", "fetch", "intel"]) == 2
    assert "sha256 differs" in capsys.readouterr().err


@mirrored
def test_the_cache_is_verified_and_used(tmp_path):
    (tmp_path / "cache").mkdir()
    for file in DATASETS["mit-csail"].files:
        shutil.copy(SHARED / "radish" / file.name, tmp_path / "cache")
    assert [path.parent.name for path in fetch("mit-csail")] == ["cache", "cache"]


def test_a_failed_download_is_one_line_that_names_the_way_out(monkeypatch):
    import pooch

    def unreachable(*args, **kwargs):
        raise ConnectionError("no route")

    monkeypatch.setattr(pooch, "retrieve", unreachable)
    with pytest.raises(InputError, match=r"cannot be downloaded .*TURTLEBAG_DATA"):
        fetch("fr079")


@mirrored
def test_worlds_and_their_paths_come_from_a_server_and_are_verified(tmp_path):
    folder = tmp_path / "served"
    (folder / "path_files").mkdir(parents=True)
    for name in ("world_25.world", "path_25.npy"):
        shutil.copy(SHARED / "barn" / name, folder / ("path_files" if name.endswith("npy") else "") / name)
    names = ("world_25.world", "path_files/path_25.npy")
    whole = DATASETS["barn"].sha256
    handler = partial(SimpleHTTPRequestHandler, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        part = {"folder": f"http://127.0.0.1:{server.server_port}", "sha256": {n: whole[n] for n in names}}
        barn = DATASETS["barn"].model_copy(update=part)
        found = local_files(barn)
        assert [path.name for path in found] == ["world_25.world", "path_25.npy"]
        (folder / "world_25.world").write_text("<sdf/>")
        found[0].unlink()
        with pytest.raises(InputError, match="sha256 differs"):
            local_files(barn)
        server.shutdown()


def test_unknown_names_and_folders(monkeypatch, capsys):
    assert main(["data", "fetch", "mars"]) == 2
    assert "known: intel, fr079, mit-csail" in capsys.readouterr().err
    monkeypatch.setenv("TURTLEBAG_DATA", "nowhere")
    with pytest.raises(InputError, match="nowhere: no such folder"):
        fetch("intel")


def test_the_list_names_licence_and_citation(capsys):
    assert main(["data", "list"]) == 0
    out = capsys.readouterr().out
    for name in DATASETS:
        assert f"{name}: " in out
    assert out.count("CC BY 3.0") + out.count("  MIT;") == len(DATASETS)
    assert "Autonomous Robots" in out
