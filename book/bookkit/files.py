"""Files of the harness: written whole or not at all, and read with a message that names them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import yaml


def replace(path: Path, text: str) -> None:
    """Write by a temporary file and a rename, so that a reader never sees half a file.

    The temporary name is this process's own: two of them may write the same file.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        partial.write_text(text, encoding="utf-8", newline="")
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


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


class _UniqueKeys(yaml.SafeLoader):
    """A loader that refuses what YAML forbids and PyYAML lets pass: the last of two wins."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for name in names:
            if names.count(name) > 1 and name != "<<":
                raise yaml.constructor.ConstructorError(
                    None, None, f"{name!r} stands twice in one mapping", node.start_mark
                )
        return super().construct_mapping(node, deep)
