"""What the figures show: scales, ticks, colours of one meaning, decisions."""

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb

from tests.helpers.report_fakes import fake_localise, fake_map, fake_record, fake_run, true_room
from turtlebag.datasets.runlog import Row, RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import Trajectory, Twist
from turtlebag.pipeline.campaign.campaign_file import Figure
from turtlebag.pipeline.campaign.figures import result_over_factor
from turtlebag.reports.compare import compare, draw_pair
from turtlebag.reports.drawing import decisions_of, draw_localise, draw_map, draw_run
from turtlebag.reports.figures import runs
from turtlebag.reports.figures.album import Album
from turtlebag.reports.figures.maps import darkest, length_text, scale_length
from turtlebag.reports.figures.particles import particles, zoom_box
from turtlebag.reports.figures.series import error_axis
from turtlebag.reports.figures.style import BAD, LINES, SERIES, new_figure
from turtlebag.reports.stages import Group, load_stage

WHOLE = (-3.0, 3.0, -2.5, 2.5)


def cloud(std_m, n=500):
    return SE2.from_array(stream(3, "cloud").normal(scale=std_m, size=(n, 3)) + np.array([1.0, 0.5, 0.0]))


def width(box):
    return box[1] - box[0]


def test_a_tight_cloud_fills_its_view():
    box = zoom_box(cloud(0.03), SE2.from_xyt(1.02, 0.5, 0.0), WHOLE)
    assert 0.12 < width(box) < 0.35
    assert width(zoom_box(cloud(0.0001), None, WHOLE)) == pytest.approx(0.2)


def test_a_particle_that_strayed_does_not_widen_the_view():
    xyt = cloud(0.03).xyt.copy()
    xyt[0] = [-2.5, 2.0, 0.0]
    assert width(zoom_box(SE2.from_array(xyt), None, WHOLE)) < 0.35


def test_a_true_pose_beside_the_cloud_is_in_view_and_one_far_away_does_not_shrink_it():
    beside = zoom_box(cloud(0.03), SE2.from_xyt(1.2, 0.5, 0.0), WHOLE)
    assert beside[0] < 1.2 < beside[1]
    assert width(zoom_box(cloud(0.03), SE2.from_xyt(-2.0, -0.5, 0.0), WHOLE)) < 0.35


def test_a_cloud_over_the_whole_map_shows_the_whole_map():
    assert zoom_box(cloud(3.0), None, WHOLE) == pytest.approx((-3.0, 3.0, -3.0, 3.0))


def test_a_picture_of_particles_says_how_far_a_truth_out_of_view_is():
    truth = Trajectory(np.array([0, 10**9]), SE2.from_xyt(np.full(2, -2.0), np.full(2, 0.5), np.zeros(2)))
    figure = particles(true_room(), [(0.0, cloud(0.03))], truth)
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert "truth 3.0 m away" in texts
    assert "5 cm" in texts


@pytest.mark.parametrize("most", [0.004, 0.4, 1.4, 2.9, 5.0, 24.0, 180.0, 900.0])
def test_an_error_axis_has_at_least_three_ticks_in_view(most):
    axes = new_figure(2.0).add_subplot()
    axes.plot([0.0, 1.0, 2.0], [0.0, 0.1 * most, most])
    error_axis(axes)
    low, high = axes.get_ylim()
    ticks = [tick for tick in axes.get_yticks() if low <= tick <= high]
    assert len(ticks) >= 3
    assert high >= most


def test_the_colour_of_bad_means_nothing_else():
    usual = [to_hex(line["color"]) for line in LINES.values()] + [to_hex(colour) for colour in SERIES]
    assert to_hex(BAD) not in usual
    assert {end for end, (colour, _, _) in runs.ENDS.items() if colour != BAD} == {"reached"}
    assert BAD not in {colour for _, colour, _ in runs.DECISIONS.values()}
    # Nor any shade of it: nothing else is orange.
    hues = [np.subtract(to_rgb(colour), to_rgb(BAD)) for colour in usual]
    assert min(np.linalg.norm(hue) for hue in hues) > 0.3


def test_the_truth_is_wide_enough_to_be_seen_on_both_sides_of_any_estimate():
    estimates = [line["linewidth"] for kind, line in LINES.items() if kind != "truth"]
    assert LINES["truth"]["linewidth"] > 2.5 * max(estimates)


@pytest.mark.parametrize(
    ("across", "text"), [(0.2, "5 cm"), (1.0, "20 cm"), (6.0, "1 m"), (16.0, "2 m"), (70.0, "20 m")]
)
def test_a_scale_bar_has_a_round_length(across, text):
    assert length_text(scale_length(across)) == text


def log_of(words):
    rows = [
        Row(
            k * 10**8,
            T_world_base=SE2.from_xyt(0.1 * k, 0.0, 0.0),
            T_map_base=SE2.from_xyt(0.1 * k, 0.0, 0.0),
            T_odom_base=SE2.identity(),
            command=Twist(),
            clearance_m=0.5,
            contact_visible=False,
            contact_low=False,
            goal_index=-1,
            state=word,
        )
        for k, word in enumerate(words)
    ]
    return RunLog.of(rows)


def test_the_cases_of_a_campaign_lie_beside_the_interval_that_would_hide_them():
    rows = [{"hz": hz, "error": 0.01 * hz + 0.001 * k} for hz in (5, 10) for k in range(3)]
    figure = result_over_factor(rows, Figure(x="hz", y="error"), "error", "cm")
    figure.draw_without_rendering()
    lines = figure.axes[0].get_lines()
    (mark,) = [line for line in lines if line.get_marker() == "o"]
    clouds = [line for line in lines if line.get_marker() == "."]
    assert len(clouds) == 2
    place = mark.get_transform().transform(mark.get_xydata())[:, 0]
    points = figure.dpi / 72.0
    for at, line in zip(place, clouds, strict=True):
        beside = at - line.get_transform().transform(line.get_xydata())[:, 0]
        assert np.all(beside > points * (line.get_markersize() / 4 + 3.0)), "under the bar and its caps"


def test_the_picture_of_an_avoidance_marks_its_start_and_every_decision():
    words = [
        "wait",
        "straight",
        "slow_veer_left",
        "slow_veer_left",
        "stop_turn_right",
        "straight",
        "back_off",
    ]
    log = log_of(words)
    decisions = decisions_of(log)
    assert decisions.words == [
        "wait",
        "straight",
        "slow_veer_left",
        "stop_turn_right",
        "straight",
        "back_off",
    ]
    assert decisions.T_world_base.x.tolist() == pytest.approx([0.0, 0.1, 0.2, 0.4, 0.5, 0.6])
    truth = Trajectory(log.t_ns, log.T_world_base)
    axes = runs.run(true_room(), truth, None, [], np.zeros((0, 2)), decisions).axes[0]
    told = [text.get_text() for text in axes.get_legend().get_texts()]
    assert told == ["true path", "veers", "stops and turns", "backs off"]
    # The start's word and its arrow, and an arrow for each decision.
    assert [text.get_text() for text in axes.texts].count("start") == 1
    assert len(axes.texts) == 2 + 3


class Kept(Album):
    """Captions and what is to be drawn, by the names of the pictures; nothing is drawn."""

    def __init__(self):
        super().__init__(None, animate=False)
        self.kept = {}

    def add(self, name, title, caption, draw, *drawn):
        self.kept[name] = caption, drawn


def pictures_of(draw, folder, *others):
    album, stage = Kept(), load_stage(folder)
    draw(stage, Group("room", (stage, *(load_stage(other) for other in others))), album)
    return album.kept


def test_a_collision_is_one_mark_however_often_its_contact_flickers(tmp_path):
    record = fake_record(tmp_path / "record")
    run = fake_run(tmp_path / "run", fake_map(tmp_path / "map", record), missed=True)
    log = RunLog.load(run / "runlog.csv")
    log.contact_visible[[403, 407]] = False
    log.save(run / "runlog.csv")
    contacts_xy = pictures_of(draw_run, run)["path"][1][4]
    np.testing.assert_allclose(contacts_xy, log.T_world_base.xy[[400]])


def test_the_caption_of_every_axis_of_errors_says_where_it_is_logarithmic(tmp_path):
    record = fake_record(tmp_path / "record")
    built = fake_map(tmp_path / "map", record)
    run, found = fake_run(tmp_path / "run", built), fake_localise(tmp_path / "localise", record, built)
    captions = [
        pictures_of(draw_map, built, record)["time"][0],
        pictures_of(draw_run, run)["localisation"][0],
        pictures_of(draw_localise, found, record)["error"][0],
    ]
    runs_compared, maps_compared = Kept(), Kept()
    draw_pair(compare([("run", [load_stage(run)])] * 2).pair, runs_compared)
    draw_pair(compare([("map", [load_stage(built)])] * 2).pair, maps_compared)
    captions += [runs_compared.kept["errors"][0], maps_compared.kept["apart"][0]]
    said = "exceeds 3, its axis is logarithmic from 1 upwards."
    assert [caption for caption in captions if said not in caption] == []


def test_the_nearest_place_of_a_roomy_path_does_not_look_bad():
    path = Trajectory.untimed(SE2.from_xyt(np.linspace(0.0, 1.0, 5), np.zeros(5), np.zeros(5)))
    axes = runs.clearance_on_map(None, path, np.array([0.9, 0.8, 0.7, 0.8, 0.9])).axes[0]
    assert BAD not in {line.get_color() for line in axes.get_lines()}


def test_a_wall_of_one_cell_stays_in_a_picture_with_too_few_pixels():
    image = np.ones((70, 101, 3))
    image[:, 50], image[33, :] = 0.0, 0.2
    small = darkest(image, 3)
    assert small.shape == (24, 34, 3)
    assert (small[:, 50 // 3] == 0.0).all()
    assert (np.delete(small[33 // 3], 50 // 3, axis=0) == 0.2).all()
    assert (small == 1.0).all(axis=-1).sum() == 23 * 33
