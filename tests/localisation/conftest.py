"""What several tests of localisation read."""

import pytest

from tests.helpers.localisation_room import l_shaped_room


@pytest.fixture(scope="session")
def room():
    """The map of the synthetic room; nobody changes it."""
    return l_shaped_room()
