"""What several tests of bags read."""

import pytest

from tests.helpers.bag_samples import write_drive


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    """A bag of six seconds with the topics of navigation; nobody writes to it."""
    folder = tmp_path_factory.mktemp("drive") / "bag"
    write_drive(folder, seconds=6, navigation=True)
    return folder
