"""Files of the harness: written whole or not at all, and read with a message that names them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from seedslib.base.atomic import write_whole


def replace(path: Path, text: str) -> None:
    """Write a text, in the place of an old one when all is there."""
    write_whole(path, text.encode())


def read_yaml(path: Path, what: str) -> Any:
    """Content of a YAML file.

    Raises
    ------
    ValueError
        No such file, not text, not YAML, or a key that stands twice in one mapping.
    """
    try:
        return yaml.load(path.read_text(encoding="utf-8"), _UniqueKeys)
    except (FileNotFoundError, IsADirectoryError):
        raise ValueError(f"{path}: no such {what}") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a text file in UTF-8") from None
    except yaml.YAMLError as error:
        raise ValueError(f"{path}: not YAML: {' '.join(str(error).split())}") from None


class _UniqueKeys(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """A loader that refuses what YAML forbids and PyYAML lets pass: the last of two wins."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for name in names:
            if names.count(name) > 1 and name != "<<":
                raise yaml.constructor.ConstructorError(
                    None, None, f"{name!r} stands twice in one mapping", node.start_mark
                )
        return super().construct_mapping(node, deep)
