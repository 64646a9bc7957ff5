"""Nothing that is not ours is replaced or removed, and only one process writes an output."""

import io
import os
from pathlib import Path

import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from tests.helpers.full_disks import ordinary_user
from tests.helpers.output_folders import folder_with, ours, state, write
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.output_rules import MARKER
from turtlebag.datasets.outputs import sha256_tree, staged_file, staged_output, write_manifest
from turtlebag.pipeline.cli.main import main


def png(**texts):
    """A picture of one pixel with these texts in it."""
    info, picture = PngInfo(), io.BytesIO()
    for key, text in texts.items():
        info.add_text(key, text)
    Image.new("L", (1, 1)).save(picture, "PNG", pnginfo=info)
    return picture.getvalue()


PNG = png(Software="turtlebag")


NOT_OURS = {
    "fifo": os.mkfifo,
    "file": lambda path: path.write_text("years"),
    "picture of others": lambda path: path.write_bytes(png(Software="GIMP", Title="turtlebag")),
    "picture cut short": lambda path: path.write_bytes(PNG[:40]),
    "link to ours": lambda path: path.symlink_to(ours(path.with_name("ours"))),
    "link to nowhere": lambda path: path.symlink_to("nowhere"),
    "folder of files": folder_with("thesis.tex", "years"),
    "manifest of others": folder_with("manifest.json", '{"name": "web app", "icons": []}'),
    "manifest that is a list": folder_with("manifest.json", "[1, 2]"),
    "manifest that is text": folder_with("manifest.json", "stage outputs packages turtlebag"),
    "bag of others": folder_with("metadata.yaml", "rosbag2_bagfile_information: {}\n"),
}


@pytest.mark.parametrize("kind", NOT_OURS)
@pytest.mark.parametrize("force", [False, True])
def test_what_is_no_output_of_ours_is_never_replaced(tmp_path, kind, force):
    NOT_OURS[kind](tmp_path / "out")
    before = state(tmp_path)
    with pytest.raises(InputError), staged_output(tmp_path / "out", force=force) as partial:
        (partial / "a").write_text("a")
    assert state(tmp_path) == before


@pytest.mark.parametrize("kind", NOT_OURS)
def test_what_is_in_the_way_of_the_growing_output_is_refused_and_kept(tmp_path, kind):
    NOT_OURS[kind](tmp_path / "out.partial")
    NOT_OURS[kind](tmp_path / "out.old") if kind != "link to ours" else None
    before = state(tmp_path)
    with pytest.raises(InputError, match=r"out\.partial: is in the way"), staged_output(tmp_path / "out"):
        pass
    assert state(tmp_path) == before


def test_an_empty_folder_and_an_output_of_ours_are_replaced_and_neighbours_kept(tmp_path):
    ours(tmp_path / "ours/cases/a", old="old")  # as a campaign keeps them
    write_manifest(tmp_path / "ours", stage="sweep", command=[], inputs={}, seed=None, wall_s=0.0)
    (tmp_path / "empty").mkdir()
    for name in ("ours", "empty"):
        folder_with("thesis.tex", "years")(tmp_path / f"{name}.old")
        with staged_output(tmp_path / name, force=True) as partial:
            (partial / "new").write_text("new")
        assert [path.name for path in (tmp_path / name).iterdir()] == ["new"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "empty.old", "ours", "ours.old"]
    assert (tmp_path / "ours.old" / "thesis.tex").exists()


def linked(folder):
    (folder / "map.yaml").unlink()
    (folder / "map.yaml").symlink_to("truth/map.yaml")


STRANGERS = [
    ("notes.txt is not part of this output", lambda out: (out / "notes.txt").write_text("years")),
    ("truth/notes.txt is not part of this output", lambda out: (out / "truth/notes.txt").write_text("years")),
    ("mine/a is not part of this output", lambda out: ours(out / "mine", a="a")),
    ("a is not part of this output", lambda out: (out / "a").symlink_to("map.yaml")),
    ("a is not part of this output", lambda out: (out / "a").symlink_to("truth")),
    ("pipe is not part of this output", lambda out: os.mkfifo(out / "pipe")),
    (
        "a is not part of this output (and 1 more)",
        lambda out: [(out / name).write_text("years") for name in ("a", "b")],
    ),
    (
        "map.yaml was changed since turtlebag wrote it",
        lambda out: (out / "map.yaml").write_text("free_thresh: 0.3\n"),
    ),
    ("map.yaml was changed since turtlebag wrote it", linked),
]


@pytest.mark.parametrize(("said", "put"), STRANGERS)
def test_what_somebody_put_into_an_output_or_edited_there_is_refused_by_name(tmp_path, said, put):
    out = ours(tmp_path / "out", **{"map.yaml": "free_thresh: 0.196\n", "truth/map.yaml": "a"})
    put(out)
    before = state(tmp_path)
    with pytest.raises(InputError) as error, staged_output(out, force=True):
        pass
    assert str(error.value).startswith(f"{out}: {said}; --force does not remove it")
    assert state(tmp_path) == before


def test_what_appears_in_an_output_while_it_is_replaced_is_kept_there_and_the_result_too(tmp_path):
    out = ours(tmp_path / "out", old="old")
    with pytest.raises(InputError, match=r"notes\.txt is not part .* kept in .*out\.partial"):
        write(out, [], lambda: (out / "notes.txt").write_text("years"), force=True)
    assert {path.name for path in out.iterdir()} == {"old", "notes.txt", "manifest.json"}
    assert [path.name for path in (tmp_path / "out.partial").iterdir()] == ["a"]


@pytest.mark.parametrize(("place", "named"), [("out", "the folder"), ("out/truth", "truth/")])
def test_an_output_that_cannot_be_removed_stays_and_so_does_the_result(tmp_path, place, named):
    out = ours(tmp_path / "out", **{"truth/map.yaml": "a"})
    with ordinary_user():
        with pytest.raises(InputError, match=r"cannot be changed .* kept in .*out\.partial"):
            write(out, [], (tmp_path / place).chmod, 0o555, force=True)
        (tmp_path / "out.partial").rename(tmp_path / "kept")
        again = staged_output(out, force=True)
        with pytest.raises(InputError, match=f"out: {named} cannot be changed"), again:
            pass
    assert (out / "truth/map.yaml").read_text() == "a"
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["a"]
    assert {path.name for path in tmp_path.iterdir()} == {"out", "kept"}


def test_an_output_in_a_folder_that_cannot_be_listed_is_written(tmp_path):
    (tmp_path / "box").mkdir()
    with ordinary_user():
        (tmp_path / "box").chmod(0o300)
        for force in (False, True):
            with staged_output(tmp_path / "box/out", force=force) as partial:
                (partial / "a").write_text("a")
                write_manifest(partial, stage="map", command=[], inputs={}, seed=None, wall_s=0.0)
    assert {path.name for path in (tmp_path / "box").iterdir()} == {"out"}
    assert {path.name for path in (tmp_path / "box/out").iterdir()} == {"a", "manifest.json"}


def test_what_file_managers_leave_is_nobodys(tmp_path):
    out, read = ours(tmp_path / "out", a="a"), ours(tmp_path / "in", a="a")
    before = sha256_tree(read)
    (out / "Thumbs.db").write_text("")

    def looked_at():
        for folder in (out, read):
            (folder / ".DS_Store").write_text("")

    write(out, [read], looked_at, force=True)
    assert [path.name for path in out.iterdir()] == ["a"]
    assert sha256_tree(read) == before
    (out / "a").rename(out / ".DS_Store")
    with staged_output(out, force=True):
        pass
    assert list(out.iterdir()) == []


@pytest.mark.parametrize("deeper", ["", "deeper/still"])
@pytest.mark.parametrize("place", ["home", "current folder"])
def test_home_and_the_current_folder_are_never_replaced_nor_what_holds_them(
    tmp_path, monkeypatch, place, deeper
):
    ours(tmp_path / "out")
    inside = tmp_path / "out" / deeper
    inside.mkdir(parents=True, exist_ok=True)
    monkeypatch.setenv("HOME", str(inside)) if place == "home" else monkeypatch.chdir(inside)
    with pytest.raises(InputError, match=place), staged_output(tmp_path / "out", force=True):
        pass
    assert (tmp_path / "out" / "manifest.json").exists()


READERS = {
    "map": ("map", "IN"),
    "also": ("map", "x", "--also", "IN"),
    "truth": ("map", "x", "--truth", "IN"),
    "continue": ("map", "x", "--continue", "IN"),
    "localise": ("localise", "IN", "--map", "x"),
    "report": ("report", "x", "IN"),
    "compare": ("compare", "x", "IN"),
    "convert": ("bag", "convert", "IN"),
    "recover": ("bag", "recover", "IN"),
    "record": ("record", "--world", "empty", "--teleop", "IN"),
}
"""Commands that read a folder, x being another input."""
OVERLAPS = ("in", "in/new", "in/bag", ".", "link/new", "in/bag/../new", "twin")


@pytest.mark.slow
@pytest.mark.parametrize("verb", READERS)
def test_no_command_writes_over_into_or_around_its_input(tmp_path, monkeypatch, capsys, verb):
    root = tmp_path / "root"
    ours(ours(root / "in") / "bag", a="a")
    write_manifest(root, stage="map", command=[], inputs={}, seed=None, wall_s=0.0)
    (root / "link").symlink_to("in")
    (root / "twin").symlink_to("in")
    monkeypatch.chdir(tmp_path)
    before = state(tmp_path)
    for where in OVERLAPS:
        for named in ("root/in", "root/in/bag/..", "root/link"):
            words = [named if word == "IN" else word for word in READERS[verb]]
            assert main([*words, "--out", str(Path("root") / where), "--force"]) == 2, (where, named)
            said = capsys.readouterr().err
            assert said.count("\n") == 1
            assert "the input" in said, said
    assert state(tmp_path) == before


@pytest.mark.parametrize(
    "words",
    [
        ("plan", "--map", "IN/map.yaml", "--start", "0,0,0", "--goal", "1,0,0"),
        ("navigate", "--world", "empty", "--task", "goal", "--map", "IN/map.yaml"),
        ("map", "x", "--config", "IN/config.yaml"),
        ("map", "x", "--relations", "IN/map.yaml"),
        ("record", "--world", "IN/config.yaml"),
        ("record", "--world", "empty", "--robot", "IN/config.yaml"),
        ("sweep", "IN/config.yaml"),
        ("navigate", "--world", "empty", "--task", "avoid", "--teleop-override", "IN/config.yaml"),
        ("localise", "x", "--map", "other.yaml"),
        ("navigate", "--world", "empty", "--task", "goal", "--map", "x", "--keepout", "other.yaml"),
    ],
)
def test_a_folder_that_holds_an_input_file_is_not_replaced(tmp_path, monkeypatch, capsys, words):
    ours(tmp_path / "in", **{"map.yaml": "image: map.pgm\n", "config.yaml": "a: 1\n", "map.pgm": "P5"})
    (tmp_path / "other.yaml").write_text(
        "{image: in/map.pgm, resolution: 1.0, origin: [0, 0, 0], occupied_thresh: 0.6, free_thresh: 0.2}"
    )
    monkeypatch.chdir(tmp_path)
    before = state(tmp_path)
    assert main([*(word.replace("IN", "in") for word in words), "--out", "in", "--force"]) == 2
    assert "contains the input" in capsys.readouterr().err
    assert state(tmp_path) == before


def test_an_input_that_only_the_manifest_names_is_guarded_too(tmp_path):
    read = ours(tmp_path / "out", a="a")
    with (
        pytest.raises(InputError, match="the input"),
        staged_output(tmp_path / "out", force=True) as partial,
    ):
        write_manifest(partial, stage="map", command=[], inputs={"x": read / "a"}, seed=None, wall_s=0.0)
    assert (read / "a").exists()


@pytest.mark.parametrize("kind", ["fifo", "file", "folder of files", "link to nowhere"])
def test_a_single_file_replaces_only_a_file_of_its_kind(tmp_path, kind):
    NOT_OURS[kind](tmp_path / "out.png")
    before = state(tmp_path)
    with pytest.raises(InputError), staged_file(tmp_path / "out.png", force=True):
        pass
    assert state(tmp_path) == before


def test_a_picture_is_replaced_by_a_picture_only(tmp_path):
    (tmp_path / "out.png").write_bytes(PNG)
    with pytest.raises(InputError, match="not a folder"), staged_output(tmp_path / "out.png", force=True):
        pass
    with staged_file(tmp_path / "out.png", force=True) as file:
        file.write_bytes(png(Title="new", Software="turtlebag"))
    assert (tmp_path / "out.png").read_bytes() == png(Title="new", Software="turtlebag")
    assert [path.name for path in tmp_path.iterdir()] == ["out.png"]
    (tmp_path / "out.png.partial").write_text("mine")
    with pytest.raises(InputError, match="in the way"), staged_file(tmp_path / "out.png", force=True):
        pass
    assert (tmp_path / "out.png.partial").read_text() == "mine"


def test_folders_made_for_an_output_go_with_it(tmp_path):
    with pytest.raises(ValueError), staged_output(tmp_path / "a" / "b" / "out"):
        raise ValueError
    assert list(tmp_path.iterdir()) == []
    assert main(["map", str(tmp_path / "none"), "--out", str(tmp_path / "a" / "out")]) == 2
    assert list(tmp_path.iterdir()) == []


def test_what_appears_in_the_place_meanwhile_is_kept_and_so_is_the_result(tmp_path):
    with pytest.raises(InputError, match=r"kept in .*out\.partial"):
        write(tmp_path / "out", [], lambda: folder_with("thesis.tex", "years")(tmp_path / "out"))
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["thesis.tex"]
    assert [path.name for path in (tmp_path / "out.partial").iterdir()] == ["a"]


def test_the_mark_is_part_of_no_output_and_of_no_hash(tmp_path):
    with staged_output(tmp_path / "out") as partial:
        (partial / "a").write_text("a")
        assert (partial / MARKER).exists()
        assert set(sha256_tree(partial)) == {"a"}
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a"]
