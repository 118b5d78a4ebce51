"""Sphinx reads its options here; they stand in _config.yml."""

from pathlib import Path

import yaml

globals().update(yaml.safe_load((Path(__file__).parents[1] / "_config.yml").read_text()))
