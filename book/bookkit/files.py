"""Files of the harness: written whole or not at all, and read with a message that names them."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import yaml

from seedslib.base.atomic import write_whole

LARGEST = 1_000_000
"""Bytes of a YAML file."""

DEEPEST = 20
"""Levels of lists and mappings in one another."""


def replace(path: Path, text: str) -> None:
    """Write a text, in the place of an old one when all is there."""
    write_whole(path, text.encode())


def read_yaml(path: Path, what: str) -> Any:
    """Content of a YAML file.

    Raises
    ------
    ValueError
        No such file, not text, not YAML, or a key that stands twice in one mapping; more than
        `LARGEST` bytes or `DEEPEST` levels, or an alias, of which a few lines make any length.
    """
    try:
        with path.open("rb") as file:  # it may be a device that has no end
            content = file.read(LARGEST + 1)
        wrong = _beyond(content)
        found = None if wrong else yaml.load(content.decode(), _UniqueKeys)
    except (FileNotFoundError, IsADirectoryError):
        raise ValueError(f"{path}: no such {what}") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a text file in UTF-8") from None
    except (yaml.YAMLError, ValueError) as error:  # the second of a number or a date
        raise ValueError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    if wrong:
        raise ValueError(f"{path}: {wrong}")
    return found


def _beyond(content: bytes) -> str:
    """What is more than a file may have, in words; empty where nothing is."""
    if len(content) > LARGEST:
        return f"wanted at most {LARGEST / 1e6:g} MB"
    depth = 0
    for event in yaml.parse(content.decode(), _UniqueKeys):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            return f"wanted at most {DEEPEST} levels of lists and mappings"
        if isinstance(event, yaml.AliasEvent):
            return f"wanted every value written out, got the alias *{event.anchor}"
    return ""


class _UniqueKeys(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """A loader that refuses what YAML forbids and PyYAML lets pass: the last of two wins."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for name, count in Counter(names).items():
            if count > 1 and name != "<<":
                raise yaml.constructor.ConstructorError(
                    None, None, f"{name!r} stands twice in one mapping", node.start_mark
                )
        return super().construct_mapping(node, deep)
