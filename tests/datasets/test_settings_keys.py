"""Keys of our files: in either spelling, and a misspelt one is named."""

import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.settings import american
from turtlebag.datasets.yaml_files import checked
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.sim.world_files import WorldSpec

MODELS = (AmclConfig, NavigateConfig, SlamConfig, WorldSpec)


def world(**shape):
    return {
        "name": "w",
        "spawn": [0, 0, 0],
        "shapes": [{"kind": "cylinder", "radius": 0.1, "z": [0, 1], **shape}],
    }


def test_a_key_is_read_in_british_and_in_american_spelling():
    assert american("localisation_error_per_metre") == "localization_error_per_meter"
    british, yankee = (checked(WorldSpec, world(**{key: [1, 2]}), where="w") for key in ("centre", "center"))
    assert british == yankee
    config = checked(NavigateConfig, {"localizer": "amcl", "relocalize": {}}, where="c")
    assert config == NavigateConfig()


@pytest.mark.parametrize("model", MODELS)
def test_no_two_keys_of_a_model_differ_in_spelling_alone(model):
    names = [american(name) for name in model.model_fields]
    assert len(set(names)) == len(names)


def test_both_spellings_at_once_are_one_too_many():
    with pytest.raises(InputError, match="localizer: unknown key"):
        checked(NavigateConfig, {"localiser": "amcl", "localizer": "amcl"}, where="c")


def test_a_misspelt_key_is_named_rather_than_the_key_that_it_stands_for():
    with pytest.raises(InputError, match="centr: unknown key"):
        checked(WorldSpec, world(centr=[1, 2]), where="w")
