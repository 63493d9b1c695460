"""Pictures: scenes as Mitsuba renders them."""

import numpy as np
import pytest

import mibvh
from mibvh.picture import picture

SHAPES = {
    "sphere": '<shape type="sphere"/>',
    "instance": '<shape type="shapegroup" id="g"><shape type="sphere"/></shape>'
    '<shape type="instance"><ref id="g"/></shape>',
    "cube": '<shape type="cube"/>',
}


@pytest.mark.parametrize("integrator", ['<integrator type="path"/>', ""])
@pytest.mark.parametrize("shape", SHAPES)
def test_lit_scenes_are_rendered_in_their_colours(shape, integrator, tmp_path):
    """With spheres, instances, and without an integrator."""
    path = tmp_path / "lit.xml"
    path.write_text(
        f'<scene version="3.0.0">{integrator}<emitter type="constant"/>'
        '<sensor type="perspective"><transform name="to_world">'
        '<lookat origin="0,4,9" target="0,0,0" up="0,1,0"/></transform></sensor>'
        '<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/>'
        '<scale value="6"/></transform><bsdf type="diffuse"><rgb name="reflectance" '
        f'value="0.9,0.1,0.1"/></bsdf></shape>{SHAPES[shape]}</scene>'
    )
    scene = mibvh.load(path)
    rendered, grey = picture(scene, width=60, samples=8), picture(scene, width=60, samples=0)
    assert np.ptp(grey, axis=2).max() == 0
    floor = rendered[-4, 30]
    assert floor[0] > floor[1] + 0.3
