"""What the tests of files share."""

import json

import numpy as np
import pytest


@pytest.fixture
def rewrite():
    """Function that replaces members of an archive (None takes one away)."""

    def rewritten(path, **changes):
        with np.load(path, allow_pickle=False) as archive:
            members = {name: archive[name] for name in archive.files}
        members.update(changes)
        np.savez(path, **{k: v for k, v in members.items() if v is not None})

    return rewritten


@pytest.fixture
def header(rewrite):
    """Function that replaces entries in the header of a file (None takes one away)."""

    def changed(path, **changes):
        with np.load(path, allow_pickle=False) as archive:
            known = json.loads(archive["header"].tobytes().decode())
        known.update(changes)
        text = json.dumps({k: v for k, v in known.items() if v is not None})
        rewrite(path, header=np.frombuffer(text.encode(), dtype=np.uint8))

    return changed
