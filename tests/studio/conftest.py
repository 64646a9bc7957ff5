"""A browser, and the studio's page in it."""

import numpy as np
import pytest

from tests.helpers.browser import Browser, find_browser
from tests.studio.fakes import FakeSession, Served
from tests.studio.page import HERE, PageSession, open_page

KEEP_SOCKET = """
window.WebSocket = class extends WebSocket { constructor(url) { super(url); window.socket = this; } };
"""


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    with Browser(find_browser(), tmp_path_factory.mktemp("profile")) as browser:
        browser.call("Page.addScriptToEvaluateOnNewDocument", source=KEEP_SOCKET)
        browser.call(
            "Browser.grantPermissions", permissions=["clipboardReadWrite", "clipboardSanitizedWrite"]
        )
        browser.call("Emulation.setFocusEmulationEnabled", enabled=True)
        yield browser


@pytest.fixture
def session():
    return PageSession()


@pytest.fixture
def served(browser, session):
    with Served(session) as server:
        yield server
        browser.leave()
    assert server.failure is None


@pytest.fixture(scope="module")
def serving():
    """A server that needs no browser, of a session that does nothing."""
    with Served(FakeSession(cells=np.zeros((64, 64), dtype=np.int8))) as running:
        yield running
    assert running.failure is None


@pytest.fixture
def page(browser, served):
    open_page(browser, served)
    yield browser
    assert browser.problems() == []
    assert all(address.startswith(HERE) for address in browser.requests())
