"""What localisation refuses: a question or a setting, and the sentence that it is answered with."""

import re

import numpy as np
import pytest

from tests.helpers.localisation_room import STILL_LIDAR
from tests.localisation.filter_room import GRID, PLACE, made, scan_at
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.yaml_files import checked
from turtlebag.pipeline.localisation.global_search import GlobalSearch
from turtlebag.pipeline.localisation.likelihood_field import distance_field
from turtlebag.pipeline.localisation.nav2_yaml import read_nav2
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.localisation.surfaces import fit_surfaces

HERE = SE2.identity()
NO_WALL = "the map has no occupied cell"


def grid_of(cell):
    return OccupancyGrid(np.full((5, 5), cell, dtype=np.int8), 0.05)


def drawn_globally():
    search = GlobalSearch(grid_of(UNKNOWN), distance_field(GRID, 1.0), AmclConfig(), STILL_LIDAR.range_max)
    search.uniform(3, np.random.default_rng(0))


def globally():
    filter_ = made()
    filter_.initialise_globally()
    return filter_


def at_place():
    filter_ = made()
    filter_.initialise(PLACE)
    return filter_


def settings(**given):
    return checked(AmclConfig, given, where="c.yaml")


REFUSED = {
    "walls of a map without any": (
        lambda: distance_field(grid_of(FREE), 1.0),
        "the map has no occupied cell",
    ),
    "surfaces of a map without any": (lambda: fit_surfaces(grid_of(FREE)), "the map has no occupied cell"),
    "places on a map without free cells": (drawn_globally, "the map has no free cell"),
    "a scan before any pose": (lambda: made().update(scan_at(PLACE), HERE), "the filter has no initial pose"),
    "odometry's frame before any pose": (lambda: made().T_map_odom, "the filter has no pose yet"),
    "odometry's frame before any scan": (lambda: globally().T_map_odom, "the filter has no pose yet"),
    "the covariance before any scan": (lambda: at_place().covariance, "the filter has no pose yet"),
    "odometry that is not finite": (
        lambda: at_place().update(scan_at(PLACE), SE2(np.array([np.nan, 0.0, 0.0]))),
        "odometry is not finite",
    ),
    "more particles at least than at most": (
        lambda: settings(min_particles=500, max_particles=100),
        "c.yaml: top level: min_particles 500 exceeds max_particles 100",
    ),
    "a slow average faster than the fast one": (
        lambda: settings(recovery_alpha_slow=0.2),
        "c.yaml: top level: recovery_alpha_slow must not exceed recovery_alpha_fast",
    ),
    "a file of Nav2 without amcl": (
        lambda: read_nav2({"amcl": {}}, where="x.yaml"),
        "x.yaml: has no section `amcl: ros__parameters:`",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_refused_is_said(what):
    ask, said = REFUSED[what]
    with pytest.raises((ValueError, InputError), match=f"^{re.escape(said)}"):
        ask()
