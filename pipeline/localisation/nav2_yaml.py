"""AMCL settings from a Nav2 parameter file, or from a ROS 1 one, which has no sections.

ROS 1's odom_alpha1 to 4 are read as those of its `diff-corrected` model, which are variances as here.
"""

from __future__ import annotations

from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.localisation.parameters import AmclConfig

# Theirs -> ours; most have the same name. ROS 1 puts odom_ and laser_ before many, Nav2 calls the KLD pair
# pf_err, pf_z.
NAMES: dict[str, str] = {
    **{name: name for name in AmclConfig.model_fields if name != "refine"},
    "pf_err": "kld_err",
    "pf_z": "kld_z",
    "laser_likelihood_max_dist": "likelihood_max_dist",
    **{f"odom_alpha{i}": f"alpha{i}" for i in range(1, 5)},
    **{f"laser_{name}": name for name in ("max_beams", "z_hit", "z_rand", "sigma_hit")},
}


def is_nav2(data: dict[str, Any]) -> bool:
    """Whether a parsed YAML file has an amcl node with ros__parameters, or is one of ROS 1."""
    node = _amcl_node(data)
    return _is_flat(data) or (isinstance(node, dict) and "ros__parameters" in node)


def read_nav2(data: dict[str, Any], *, where: str) -> tuple[dict[str, Any], list[str]]:
    """Parameters of the `amcl` node under our names, and those we do not have; InputError without the node.

    Whatever their laser model, ours is the likelihood field with its probabilities multiplied.
    """
    node = {"ros__parameters": data} if _is_flat(data) else _amcl_node(data)
    parameters = node.get("ros__parameters") if isinstance(node, dict) else None
    if not isinstance(parameters, dict):
        raise InputError(f"{where}: has no section `amcl: ros__parameters:`")
    known = {NAMES[name]: value for name, value in parameters.items() if name in NAMES}
    return known, sorted(str(name) for name in parameters if name not in NAMES)


def _is_flat(data: dict[str, Any]) -> bool:
    """Whether amcl's parameters stand at the top, as in a file for ROS 1's node."""
    return not NAMES.keys().isdisjoint(data)


def _amcl_node(data: dict[str, Any]) -> Any:
    """The amcl node, at the top or below a namespace (`/**:`, `robot1:`)."""
    if "amcl" in data:
        return data["amcl"]
    spaces = (value for value in data.values() if isinstance(value, dict))
    return next((space["amcl"] for space in spaces if "amcl" in space), None)
