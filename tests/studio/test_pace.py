"""When ticks are due, by a clock that stands still unless it is moved."""

import pytest

from tests.studio.fakes import PERIOD_NS, FakeSession, Served, connect, run
from turtlebag.pipeline.studio.inputs import Button, Speed
from turtlebag.pipeline.studio.pace import LATE_S, Pace, Pacer

PERIOD_S = 1 / 32
"""Binary fractions add up without a rest."""


class Clock:
    """A pacer, and the wall clock that it looks at."""

    def __init__(self):
        self.now, self.stamp_ns = 100.0, 0
        self.pacer = Pacer(PERIOD_S, lambda: self.now)

    def asked(self, do, **fields):
        self.pacer.control(Speed(do=do, **fields) if fields else Button(do=do))

    def ticks(self, most=1000):
        """Ticks taken while the clock stands still."""
        taken = 0
        while taken < most and self.pacer.take():
            self.stamp_ns += round(PERIOD_S * 1e9)
            self.pacer.count(self.stamp_ns)
            taken += 1
        return taken

    def over(self, seconds):
        """Ticks taken while it goes on for so long, looked at 256 times a second."""
        taken = 0
        for _ in range(round(256 * seconds)):
            self.now += 1 / 256
            taken += self.ticks()
        return taken


@pytest.fixture
def clock():
    return Clock()


@pytest.mark.parametrize("factor", [1.0, 0.5, 4.0])
def test_simulated_time_passes_at_the_speed_that_is_asked_for(clock, factor):
    clock.asked("speed", factor=factor)
    assert clock.ticks() == 1
    assert clock.pacer.wait_s() == PERIOD_S / factor
    assert clock.over(2.0) == 64 * factor
    assert clock.pacer.pace(idle=False) == Pace(pytest.approx(factor, rel=0.03), factor, False)
    assert clock.pacer.pace(idle=True) == Pace(0.0, factor, False)


def test_at_speed_zero_a_tick_is_always_due(clock):
    clock.asked("speed", factor=0.0)
    assert clock.ticks(500) == 500
    assert clock.pacer.wait_s() == 0.0
    assert clock.pacer.pace(idle=False).factor > 100.0


def test_while_it_is_paused_only_single_ticks_are_due(clock):
    clock.over(1.0)
    clock.asked("step")
    assert clock.ticks() == 0
    clock.asked("pause")
    assert clock.over(1.0) == 0
    assert clock.pacer.wait_s() is None
    assert clock.pacer.pace(idle=False) == Pace(0.0, 1.0, True)
    for _ in range(3):
        clock.asked("step")
    assert clock.pacer.wait_s() == 0.0
    assert clock.ticks() == 3
    clock.asked("step")
    clock.asked("pause")
    assert clock.ticks() == 0
    clock.asked("step")
    clock.asked("resume")
    assert clock.ticks() == 1  # neither the step nor the pause is made up for
    assert clock.over(1.0) == 32


def test_a_short_delay_is_caught_up_with_and_a_long_one_given_up(clock):
    clock.ticks()
    clock.now += 4 * PERIOD_S
    assert clock.ticks() == 4
    clock.now += 100 * PERIOD_S
    assert clock.ticks() <= 1 + LATE_S / PERIOD_S
    assert clock.over(1.0) == pytest.approx(32, abs=1)


@pytest.mark.slow
def test_a_step_at_the_end_of_a_bag_is_not_kept_for_later():
    session = FakeSession()
    session.idle = True

    async def step():
        client = await connect(served.url)
        for do in ("pause", "step", "step"):
            client.ask(do)
        await client.until(lambda p: p.head.get("paused"))
        await client.read_for(0.3)
        session.idle = False
        await client.read_for(0.3)
        assert session.stamp_ns == 0
        client.ask("step")
        await client.until(lambda p: p.head["t"] > 0.0)
        await client.read_for(0.3)

    with Served(session) as served:
        run(step())
    assert session.stamp_ns == PERIOD_NS
