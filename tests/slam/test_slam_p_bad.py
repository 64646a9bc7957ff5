"""The probability that a map is bad: what speaks against it only ever adds."""

from pathlib import Path

import pytest

from turtlebag.pipeline.slam.check.p_bad import DOUBTFUL, MOST, WEIGHTS, Term, doublings, p_bad, reasons
from turtlebag.reports.metric_specs import SPECS

ROOT = Path(__file__).parents[2]
NAMES = list(WEIGHTS)


def terms(**sizes):
    """Terms by name, whose reason is their name."""
    return [Term(name, size, name) for name, size in sizes.items()]


@pytest.mark.parametrize("name", NAMES)
def test_no_term_makes_a_map_better(name):
    found = [
        p_bad(terms(uncertain=0.3, **({name: size} if name != "uncertain" else {}))) for size in (0, 1, 2)
    ]
    assert found == sorted(found)
    assert p_bad(terms(**{name: MOST})) == p_bad(terms(**{name: 10.0 * MOST}))


def test_a_map_without_terms_is_good_and_one_with_all_is_bad():
    assert p_bad([]) < 0.1 < DOUBTFUL
    assert p_bad(terms(**dict.fromkeys(NAMES, MOST))) > 0.999


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size", [0.0, 0.5, 1.0, 3.0])
def test_a_map_is_doubtful_from_the_threshold_on_and_then_for_a_reason(name, size):
    found = terms(**{name: size})
    assert bool(reasons(found)) == (p_bad(found) >= DOUBTFUL)


def test_small_doubts_together_are_one_and_the_weightiest_comes_first():
    assert reasons(terms(uncertain=0.8)) == reasons(terms(thick=0.4)) == ()
    assert reasons(terms(thick=0.4, uncertain=0.8)) == ("uncertain", "thick")
    assert reasons(terms(uncertain=0.1, motion=1.0)) == ("motion",)


def test_sizes_are_doublings_above_the_usual():
    assert [doublings(value, 0.1) for value in (0.0, 0.05, 0.1, 0.2, 0.8)] == [0.0, 0.0, 0.0, 1.0, 3.0]


def test_reports_and_docs_name_the_threshold_that_counts():
    threshold = f"{100.0 * DOUBTFUL:.0f} %"
    (spec,) = (spec for spec in SPECS["map"] if spec.path == "self_check.p_bad")
    assert f"Doubtful from {threshold} on." in spec.meaning
    assert f"below {threshold} is *good*" in (ROOT / "docs/how-it-maps.md").read_text()
