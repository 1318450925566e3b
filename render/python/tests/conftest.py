import pytest

import render_gradients as rg


@pytest.fixture
def room() -> rg.Scene:
    scene = rg.room(16, 12)
    scene.spp = 16
    return scene
