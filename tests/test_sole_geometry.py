"""Soles from the shapes of feet."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial import ConvexHull
from test_support_design import walker_urdf
from test_support_verification import SHAPES, solid_walker_urdf

from excite.api import design_support
from excite.designer.sole_geometry import find_sole, largest_rectangle
from excite.designer.support_design import SupportOptions
from excite.errors import UnusableInput
from excite.robot import floating_base


def loaded(tmp_path, text):
    path = tmp_path / "walker.urdf"
    path.write_text(text)
    return floating_base.load(path)


@pytest.mark.parametrize(("frame", "height"), [("right_sole", 0.0), ("right_ankle_roll", -0.09)])
def test_a_box_is_its_own_sole(tmp_path, frame, height):
    robot = loaded(tmp_path, solid_walker_urdf())
    sole = find_sole(robot.joint_robot, frame)
    assert (sole.half_length, sole.half_width) == pytest.approx((0.1, 0.06), abs=1e-4)
    assert sole.centre == pytest.approx((0.01, 0.0), abs=1e-4)
    assert sole.height == pytest.approx(height, abs=1e-9)
    assert len(sole.outline) == 4
    assert "collision" in sole.source


def test_visual_shapes_serve_where_there_are_no_collision_shapes(tmp_path):
    shape = '<visual><geometry><box size="0.1 0.05 0.02"/></geometry></visual>'
    link = '<link name="left_ankle_roll_link">'
    text = walker_urdf().replace(link, link + shape)
    sole = find_sole(loaded(tmp_path, text).joint_robot, "left_sole")
    assert sole.half_length == pytest.approx(0.05, abs=1e-4)
    assert sole.height == pytest.approx(0.08)
    assert "visual" in sole.source


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ('<geometry><sphere radius="0.03"/></geometry>', "form no flat sole"),
        (
            '<origin rpy="0.5 0 0"/><geometry><box size="0.2 0.1 0.02"/></geometry>',
            "form no flat sole",
        ),
        ('<geometry><mesh filename="gone.stl"/></geometry>', "gone.stl"),
    ],
)
def test_feet_without_a_flat_sole_are_refused(tmp_path, shape, message):
    text = solid_walker_urdf().replace(SHAPES["left_ankle_roll_link"], shape)
    robot = loaded(tmp_path, text)
    with pytest.raises(UnusableInput, match=message) as fault:
        find_sole(robot.joint_robot, "left_sole")
    assert "--sole" in str(fault.value)


def test_the_largest_rectangle_of_a_triangle_halves_its_sides():
    corners = np.array([[0.0, 0.0], [0.2, 0.0], [0.0, 0.1]])
    centre, half = largest_rectangle(ConvexHull(corners).equations)
    np.testing.assert_allclose(half, [0.05, 0.025], rtol=1e-3)
    np.testing.assert_allclose(centre, [0.05, 0.025], rtol=1e-3)


def test_a_rectangle_in_a_random_outline_touches_it_and_none_is_larger():
    rng = np.random.default_rng(4)
    hull = ConvexHull(rng.normal(size=(12, 2)))
    centre, half = largest_rectangle(hull.equations)
    normal, offset = hull.equations[:, :2], hull.equations[:, 2]
    room = -(normal @ centre + np.abs(normal) @ half + offset)
    assert room.min() == pytest.approx(0.0, abs=1e-9)
    for _ in range(2000):
        trial = centre + rng.normal(size=2), half * np.exp(0.5 * rng.normal(size=2))
        if (normal @ trial[0] + np.abs(normal) @ trial[1] + offset <= 0.0).all():
            assert np.prod(trial[1]) <= np.prod(half) * (1.0 + 1e-6)


def test_a_design_without_stated_soles_has_those_of_the_shapes(tmp_path):
    robot = loaded(tmp_path, solid_walker_urdf())
    options = SupportOptions(
        ("right_ankle_roll_link",),
        (),
        duration=2.0,
        harmonics=2,
        starts=1,
        iterations=2,
        rate=50.0,
        wrench_noise=(0.5, 1.5),
    )
    result = design_support(robot, options, progress=lambda text: None)
    (foot,) = result.trajectory.feet
    assert foot.half_width == pytest.approx(0.06, abs=1e-4)
    assert foot.sole_centre[2] == pytest.approx(-0.09)
    assert "shapes" in result.html()
    ankle = result.samples[0].motion
    model = robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.concatenate([ankle.pose[0], ankle.q[0]]))
    height = data.oMf[model.getFrameId("right_ankle_roll_link")].translation[2]
    assert height == pytest.approx(0.09, abs=1e-9)
