"""A small campaign, of stages that know their answer at once."""

CAMPAIGN = """
name: small
question: Does it?
factors:
  size: [1, 2, 3]
  kind: {plain: "", strange: "--odd 'two words'"}
  seed: {first: 1, last: 4}
stages:
  make: "fake --size {size} --seed {seed} {kind}"
  check: "fake --size {size} --of {make}/metrics.json"
results: {error_m: {at: "make:error.rmse", label: error, unit: cm}, good: "check:good"}
compare: size
against: 1
figures:
  - {x: size, y: error_m, lines: kind}
  - {x: size, y: good, panels: kind}
"""
UNDRAWN = CAMPAIGN.partition("figures:")[0]
"""The same without pictures, which take longer than all of its cases."""
