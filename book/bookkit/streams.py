"""What a cell printed, in one piece for each stream, as a terminal would show it."""

from __future__ import annotations

from typing import Any


def merged(outputs: list[Any]) -> list[Any]:
    """Outputs of a cell with its pieces of each stream in one, standard output first.

    The option ``coalesce_streams`` of nbclient means the same and takes time that grows with the
    square of the length of a line.

    Parameters
    ----------
    outputs : list of dict
    """
    kept: list[Any] = []
    texts: dict[str, list[str]] = {}
    for output in outputs:
        if output["output_type"] == "stream":
            if output["name"] not in texts:
                kept.append(output)
            texts.setdefault(output["name"], []).append(output["text"])
        else:
            kept.append(output)
    for output in kept:
        if output["output_type"] == "stream":
            output["text"] = shown("".join(texts[output["name"]]))
    names = [output.get("name") for output in kept]
    for place in range(len(kept) - 1):
        if names[place : place + 2] == ["stderr", "stdout"]:
            kept[place : place + 2] = kept[place + 1], kept[place]
            break
    return kept


def shown(text: str) -> str:
    """What is left of each line: all behind its last carriage return but one at its end."""
    if "\r" not in text:
        return text
    return "\n".join(line[line.rfind("\r", 0, len(line) - 1) + 1 :] for line in text.split("\n"))
