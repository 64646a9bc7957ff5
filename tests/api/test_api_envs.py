"""The Gymnasium environment: Gymnasium's own check, and what its rewards go by."""

import sys
import warnings

import numpy as np
import pytest

import turtlebag as tb

pytestmark = pytest.mark.slow


def test_without_gymnasium_a_line_names_the_extra(monkeypatch):
    monkeypatch.delitem(sys.modules, "turtlebag.envs", raising=False)
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(tb.InputError, match=r"needs gymnasium; run: pip install 'turtlebag\[envs\]'"):
        _ = tb.envs


def test_the_environment_passes_gymnasiums_check_and_rewards_by_the_truth():
    gymnasium = pytest.importorskip("gymnasium", reason="no gymnasium here")
    from gymnasium.utils.env_checker import check_env

    env = gymnasium.make("turtlebag.envs:TurtleBag/Goal-v0")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    seen, info = env.reset(seed=3, options={"goal": (-1.5, -0.5)})
    assert seen[SECTORS] == pytest.approx(0.5, abs=0.01)
    rewards = []
    for _ in range(30):
        seen, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0], dtype=np.float32))
        rewards.append(reward)
        if terminated or truncated:
            break
    assert info["reached"]
    assert sum(rewards) == pytest.approx(10.0 + 0.5 - info["distance_m"], abs=1e-3)
    with pytest.raises(tb.InputError, match="goal: expected x, y"):
        env.reset(options={"goal": (1, np.nan)})
    env.close()


SECTORS = 36
