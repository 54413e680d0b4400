"""Robots of public wheels that `robots.py` tries: files, moving joints and missing limits.

Where a robot has more joints than one would excite at once, the moving ones are listed, and the
others are locked at their neutral positions.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Case:
    """A robot to try.

    Attributes:
        name: Name in the table.
        path: URDF or MJCF below its folder.
        joints: Joints that move; None: all but the locked ones.
        lock: Positions of the locked joints.
        assumed: Limits of joints for which the file states none, by quantity (an MJCF cannot state
            a velocity) [rad/s or m/s, N m or N].
    """

    name: str
    path: str
    joints: tuple[str, ...] | None = None
    lock: dict[str, float] = field(default_factory=dict)
    assumed: dict[str, float] = field(default_factory=dict)


def _numbered(pattern: str, numbers: Iterable[int]) -> tuple[str, ...]:
    return tuple(pattern.format(number) for number in numbers)


# grippers are locked, except in one robot of each kind (panda_hand, z1, so101)
WHEEL = (
    Case("ur3", "ur_description/urdf/ur3_robot.urdf"),
    Case("ur5", "ur_description/urdf/ur5_robot.urdf"),
    Case("ur10", "ur_description/urdf/ur10_robot.urdf"),
    Case("panda_arm", "panda_description/urdf/panda.urdf", lock={"panda_finger_joint1": 0.02}),
    Case("panda_hand", "panda_description/urdf/panda.urdf"),
    Case("xarm7", "xarm_description/urdf/xarm7.urdf"),
    Case("z1", "z1_description/urdf/z1.urdf"),
    Case("kinova", "kinova_description/robots/kinova.urdf"),
    Case("so101", "so_arm_description/urdf/so101.urdf"),
    Case(
        "baxter",
        "baxter_description/urdf/baxter.urdf",
        tuple(f"right_{j}" for j in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")),
    ),
    Case("tiago", "tiago_description/robots/tiago.urdf", _numbered("arm_{}_joint", range(1, 8))),
    Case(
        "talos", "talos_data/robots/talos_reduced.urdf", _numbered("arm_left_{}_joint", range(1, 8))
    ),
    Case(
        "talos_left_arm", "talos_data/robots/talos_left_arm.urdf", lock={"gripper_left_joint": 0.0}
    ),
    Case("double_pendulum", "double_pendulum_description/urdf/double_pendulum.urdf"),
    Case(
        "double_pendulum_continuous",
        "double_pendulum_description/urdf/double_pendulum_continuous.urdf",
    ),
)
_UR_ARM = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
_ANYMAL = "anymal_b_simple_description/robots"

# limbs of robots that nobody adapted: the other joints are locked at their neutral positions
LIMBS = (
    Case("bolt_leg", "bolt_description/robots/bolt.urdf", ("FL_HAA", "FL_HFE", "FL_KFE")),
    Case(
        "hyq_leg",
        "hyq_description/robots/hyq_no_sensors.urdf",
        ("lf_haa_joint", "lf_hfe_joint", "lf_kfe_joint"),
    ),
    Case("anymal_leg", f"{_ANYMAL}/anymal.urdf", ("LF_HAA", "LF_HFE", "LF_KFE")),
    Case("anymal_hind_leg", f"{_ANYMAL}/anymal.urdf", ("RH_HAA", "RH_HFE", "RH_KFE")),
    Case(
        "anymal_kinova",
        f"{_ANYMAL}/anymal-kinova.urdf",
        _numbered("j2s6s200_joint_{}", range(1, 7)),
    ),
    Case("solo12_leg", "solo_description/robots/solo12.urdf", ("FL_HAA", "FL_HFE", "FL_KFE")),
    Case("quadruped_leg", "quadruped_description/urdf/quadruped.urdf", ("FL_HFE", "FL_KFE")),
    Case(
        "laikago_leg",
        "laikago_description/urdf/laikago.urdf",
        ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint"),
    ),
    Case(
        "go1_leg",
        "go1_description/urdf/go1.urdf",
        ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint"),
    ),
    Case(
        "go2_leg",
        "go2_description/urdf/go2.urdf",
        ("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint"),
    ),
    Case(
        "a1_leg", "a1_description/urdf/a1.urdf", ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint")
    ),
    Case("b1_z1_arm", "b1_description/urdf/b1-z1.urdf", _numbered("joint{}", range(1, 7))),
    Case("hextilt_arm", "hextilt_description/urdf/hextilt_flying_arm_5.urdf"),
    Case("borinot_arm", "borinot_description/urdf/borinot_flying_arm_2.urdf"),
    Case("two_dofs", "asr_twodof_description/urdf/TwoDofs.urdf"),
    Case("finger_edu", "finger_edu_description/robots/finger_edu.urdf"),
    Case(
        "allegro_finger",
        "allegro_hand_description/urdf/allegro_right_hand.urdf",
        _numbered("joint_{}.0", range(4)),
    ),
    Case(
        "icub_arm",
        "icub_description/robots/icub.urdf",
        ("l_shoulder_pitch", "l_shoulder_roll", "l_shoulder_yaw", "l_elbow", "l_wrist_prosup"),
    ),
    Case(
        "icub_whole_arm",
        "icub_description/robots/icub.urdf",
        (
            *("l_shoulder_pitch", "l_shoulder_roll", "l_shoulder_yaw", "l_elbow"),
            *("l_wrist_prosup", "l_wrist_pitch", "l_wrist_yaw"),
        ),
    ),
    Case(
        "icub_leg",
        "icub_description/robots/icub.urdf",
        ("l_hip_pitch", "l_hip_roll", "l_hip_yaw", "l_knee", "l_ankle_pitch", "l_ankle_roll"),
    ),
    Case(
        "centauro_arm",
        "centauro_description/urdf/centauro.urdf",
        _numbered("j_arm1_{}", range(1, 7)),
    ),
    Case(
        "g1_arm",
        "g1_description/urdf/g1_29dof_rev_1_0.urdf",
        (
            *("left_shoulder_pitch_joint", "left_shoulder_roll_joint", "left_shoulder_yaw_joint"),
            *("left_elbow_joint", "left_wrist_roll_joint", "left_wrist_pitch_joint"),
            "left_wrist_yaw_joint",
        ),
    ),
    Case(
        "g1_leg",
        "g1_description/urdf/g1_29dof_rev_1_0.urdf",
        (
            *("left_hip_pitch_joint", "left_hip_roll_joint", "left_hip_yaw_joint"),
            *("left_knee_joint", "left_ankle_pitch_joint", "left_ankle_roll_joint"),
        ),
    ),
    Case(
        "pr2_arm",
        "pr2_description/urdf/pr2.urdf",
        (
            *("r_shoulder_pan_joint", "r_shoulder_lift_joint", "r_upper_arm_roll_joint"),
            *("r_elbow_flex_joint", "r_forearm_roll_joint", "r_wrist_flex_joint"),
            "r_wrist_roll_joint",
        ),
    ),
    Case(
        "romeo_arm",
        "romeo_description/urdf/romeo.urdf",
        (
            *("LShoulderPitch", "LShoulderYaw", "LElbowRoll", "LElbowYaw"),
            *("LWristRoll", "LWristYaw", "LWristPitch"),
        ),
    ),
    Case(
        "alex_arm",
        "alex_description/urdf/alex_nub_hands.urdf",
        (
            *("LeftShoulderPitch", "LeftShoulderRoll", "LeftShoulderYaw", "LeftElbowPitch"),
            *("LeftWristYaw", "LeftWristRoll", "LeftGripperYaw"),
        ),
    ),
    Case(
        "tiago_pro_arm",
        "tiago_pro_description/robots/tiago_pro.urdf",
        _numbered("arm_left_{}_joint", range(1, 8)),
    ),
    Case(
        "talos_leg",
        "talos_data/robots/talos_full_v2.urdf",
        _numbered("leg_left_{}_joint", range(1, 7)),
    ),
    Case(
        "simple_humanoid_arm",
        "simple_humanoid_description/urdf/simple_humanoid.urdf",
        (
            *("LARM_SHOULDER_P", "LARM_SHOULDER_R", "LARM_SHOULDER_Y", "LARM_ELBOW"),
            *("LARM_WRIST_Y", "LARM_WRIST_P", "LARM_WRIST_R"),
        ),
    ),
    Case(
        "ur3_gripper",
        "ur_description/urdf/ur3_gripper.urdf",
        tuple(f"{joint}_joint" for joint in _UR_ARM),
    ),
    Case("ur5_limited", "ur_description/urdf/ur5_joint_limited_robot.urdf"),
    Case("ur10_limited", "ur_description/urdf/ur10_joint_limited_robot.urdf"),
    Case("so100", "so_arm_description/urdf/so100.urdf"),
)
_G1 = "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf"
_TALOS = "talos_data/robots"

# further URDFs of example-robot-data
LIMBS += (
    Case("ur3_limited", "ur_description/urdf/ur3_joint_limited_robot.urdf"),
    Case("ur5_gripper", "ur_description/urdf/ur5_gripper.urdf"),
    Case(
        "panda_spheres",
        "panda_description/urdf/panda_collision.urdf",
        lock={"panda_finger_joint1": 0.02},
    ),
    Case("solo_leg", "solo_description/robots/solo.urdf", ("FL_HFE", "FL_KFE")),
    Case(
        "anymal_c_leg",
        "anymal_c_simple_description/urdf/anymal.urdf",
        ("LF_HAA", "LF_HFE", "LF_KFE"),
    ),
    Case(
        "hyq_hind_leg",
        "hyq_description/robots/hyq_no_sensors.urdf",
        ("rh_haa_joint", "rh_hfe_joint", "rh_kfe_joint"),
    ),
    Case(
        "b1_leg", "b1_description/urdf/b1.urdf", ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint")
    ),
    Case(
        "allegro_left_thumb",
        "allegro_hand_description/urdf/allegro_left_hand.urdf",
        _numbered("joint_{}.0", range(12, 16)),
    ),
    Case(
        "g1_hand_arm",
        _G1,
        (
            *("right_shoulder_pitch_joint", "right_shoulder_roll_joint"),
            *("right_shoulder_yaw_joint", "right_elbow_joint", "right_wrist_roll_joint"),
            *("right_wrist_pitch_joint", "right_wrist_yaw_joint"),
        ),
    ),
    Case(
        "g1_thumb",
        _G1,
        _numbered("left_hand_thumb_{}_joint", range(3)),
    ),
    Case("g1_waist", _G1, ("waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint")),
    Case(
        "human_arm",
        "human_description/robots/human.urdf",
        ("right_shoulder_Z", "right_shoulder_X", "right_shoulder_Y", "right_elbow_Z"),
    ),
    Case(
        "human_leg",
        "human_description/robots/human.urdf",
        ("left_hip_Z", "left_hip_X", "left_hip_Y", "left_knee_Z", "left_ankle_Z"),
    ),
    Case(
        "alexander_leg",
        "alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf",
        (
            *("LEFT_HIP_X", "LEFT_HIP_Z", "LEFT_HIP_Y"),
            *("LEFT_KNEE_Y", "LEFT_ANKLE_Y", "LEFT_ANKLE_X"),
        ),
    ),
    Case(
        "alex_sake_arm",
        "alex_description/urdf/alex_sake_hands.urdf",
        (
            *("RightShoulderPitch", "RightShoulderRoll", "RightShoulderYaw", "RightElbowPitch"),
            *("RightWristYaw", "RightWristRoll", "RightGripperYaw"),
        ),
    ),
    Case(
        "alex_psyonic_arm",
        "alex_description/urdf/alex_psyonic_hands.urdf",
        (
            *("LeftShoulderPitch", "LeftShoulderRoll", "LeftShoulderYaw", "LeftElbowPitch"),
            *("LeftWristYaw", "LeftWristRoll", "LeftGripperYaw"),
        ),
    ),
    Case(
        "romeo_small_leg",
        "romeo_description/urdf/romeo_small.urdf",
        ("LHipYaw", "LHipRoll", "LHipPitch", "LKneePitch", "LAnklePitch", "LAnkleRoll"),
    ),
    Case(
        "romeo_laas_arm",
        "romeo_description/urdf/romeo_laas_small.urdf",
        (
            *("RShoulderPitch_joint", "RShoulderYaw_joint", "RElbowRoll_joint"),
            *("RElbowYaw_joint", "RWristRoll_joint", "RWristYaw_joint", "RWristPitch_joint"),
        ),
    ),
    Case(
        "talos_box_leg",
        f"{_TALOS}/talos_reduced_box.urdf",
        _numbered("leg_right_{}_joint", range(1, 7)),
    ),
    Case(
        "talos_corrected_arm",
        f"{_TALOS}/talos_reduced_corrected.urdf",
        _numbered("arm_right_{}_joint", range(1, 8)),
    ),
    Case(
        "talos_full_torso",
        f"{_TALOS}/talos_full_v2_box.urdf",
        ("torso_1_joint", "torso_2_joint"),
    ),
    Case(
        "icub_reduced_arm",
        "icub_description/robots/icub_reduced.urdf",
        ("r_shoulder_pitch", "r_shoulder_roll", "r_shoulder_yaw", "r_elbow", "r_wrist_prosup"),
    ),
    Case(
        "tiago_dual_arm",
        "tiago_description/robots/tiago_dual.urdf",
        _numbered("arm_left_{}_joint", range(1, 8)),
    ),
    Case(
        "tiago_no_hand",
        "tiago_description/robots/tiago_no_hand.urdf",
        ("torso_lift_joint", *_numbered("arm_{}_joint", range(1, 8))),
    ),
    Case(
        "pr2_left_arm",
        "pr2_description/urdf/pr2.urdf",
        (
            *("l_shoulder_pan_joint", "l_shoulder_lift_joint", "l_upper_arm_roll_joint"),
            *("l_elbow_flex_joint", "l_forearm_roll_joint"),
        ),
    ),
    Case(
        "simple_humanoid_leg",
        "simple_humanoid_description/urdf/simple_humanoid_classical.urdf",
        (
            *("RLEG_HIP_Y", "RLEG_HIP_R", "RLEG_HIP_P"),
            *("RLEG_KNEE", "RLEG_ANKLE_P", "RLEG_ANKLE_R"),
        ),
    ),
    Case("double_pendulum_simple", "double_pendulum_description/urdf/double_pendulum_simple.urdf"),
    Case("iris", "iris_description/robots/iris.urdf"),
)

_RTB = "rtb_data/rtbdata/xacro"
_VEGA = "dexmate_urdf/dexmate_urdf/robots"
_STRETCH = "hello_robot_stretch_urdf/stretch_urdf"
_ICUB = "icub_models/icub_models-3.2.0.data/data/share/iCub/robots"
_ROBOSUITE = "robosuite/robosuite/models/assets/robots"
_SUITE = "dm_control/dm_control/suite"
_GYM = "gymnasium_robotics/gymnasium_robotics/envs"


def _kuka(name: str, path: str, torque: float) -> Case:
    folder = f"{_RTB}/kuka_description"
    return Case(name, f"{folder}/{path}", assumed={"torque": torque})


def _stretch(name: str, path: str) -> Case:
    joints = ("joint_lift", "joint_wrist_yaw", "joint_wrist_pitch", "joint_wrist_roll")
    return Case(name, f"{_STRETCH}/{path}", joints)


def _icub_limb(name: str, robot: str, *joints: str) -> Case:
    return Case(name, f"{_ICUB}/{robot}/model.urdf", joints)


# robots of other wheels, below robots.py --wheels
OTHER_WHEELS = (
    Case("irb140", f"{_RTB}/abb_irb140_description/urdf/irb140.urdf"),
    Case("kr210", f"{_RTB}/kuka_description/kuka_kr210/urdf/kr210l150.urdf"),
    _kuka("kr210_torque", "kuka_kr210/urdf/kr210l150.urdf", 15000.0),
    _kuka("lbr_iiwa_14", "kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.urdf", 300.0),
    _kuka("kr16", "kuka_kr16/urdf/kr16_2.urdf", 2000.0),
    _kuka("kr120", "kuka_kr120/urdf/kr120r2500pro.urdf", 15000.0),
    Case("puma560", f"{_RTB}/unimation_puma560_description/urdf/puma560_robot.urdf"),
    Case("al5d", f"{_RTB}/lynxmotion_al5d_description/urdf/al5d_robot.urdf"),
    Case("vega_arm", f"{_VEGA}/humanoid/vega_1/vega_1.urdf", _numbered("L_arm_j{}", range(1, 8))),
    Case(
        "vega_p_arm",
        f"{_VEGA}/humanoid/vega_1p/vega_1p_gripper.urdf",
        _numbered("R_arm_j{}", range(1, 8)),
    ),
    Case(
        "vega_u_arm", f"{_VEGA}/humanoid/vega_1u/vega_1u.urdf", _numbered("L_arm_j{}", range(1, 8))
    ),
    Case("vega_torso", f"{_VEGA}/humanoid/vega_1/vega_1.urdf", _numbered("torso_j{}", range(1, 4))),
    Case(
        "vega_head", f"{_VEGA}/humanoid/vega_1u/vega_1u_f5d6.urdf", _numbered("head_j{}", (1, 2, 3))
    ),
    Case("f5d6_hand", f"{_VEGA}/hands/f5d6_hand/f5d6_left.urdf"),
    _stretch("stretch_re1", "RE1V0/stretch_description_RE1V0_tool_stretch_dex_wrist.urdf"),
    _stretch("stretch_re2", "RE2V0/stretch_description_RE2V0_eoa_wrist_dw3_tool_sg3.urdf"),
    _stretch("stretch_se3", "SE3/stretch_description_SE3_eoa_wrist_dw3_tool_nil.urdf"),
    _icub_limb(
        "icub_genova_arm",
        "iCubGenova11",
        *("r_shoulder_pitch", "r_shoulder_roll", "r_shoulder_yaw", "r_elbow", "r_wrist_prosup"),
    ),
    _icub_limb(
        "icub_gazebo_leg",
        "iCubGazeboV2_7",
        *("l_hip_pitch", "l_hip_roll", "l_hip_yaw", "l_knee", "l_ankle_pitch", "l_ankle_roll"),
    ),
    _icub_limb("icub_erzelli_torso", "iCubErzelli02", "torso_pitch", "torso_roll", "torso_yaw"),
    _icub_limb("icub_wrist", "left_wrist_mk2", "l_wrist_prosup", "l_wrist_pitch", "l_wrist_yaw"),
    Case(
        "armar6_arm",
        "armar/armar/description/urdf/armar6.urdf",
        tuple(f"arm_t{joint}_joint_r0" for joint in (12, 23, 34, 45, 56, 67, 78)),
    ),
    Case(
        "armar4_arm",
        "armar/armar/description/urdf/armar4_fixed_hands.urdf",
        tuple(f"arm_{joint}_joint_r0" for joint in ("sho1", "sho2", "sho3", "sho4", "elb1")),
    ),
    Case(
        "armar4_leg",
        "armar/armar/description/urdf/armar4_fixed_hands.urdf",
        tuple(
            f"leg_{joint}_joint_r1" for joint in ("hip1", "hip2", "hip3", "knee", "ank1", "ank2")
        ),
    ),
    Case(
        "jvrc_arm",
        "jvrc_description/jvrc_description/urdf/jvrc1.urdf",
        (
            *("R_SHOULDER_P", "R_SHOULDER_R", "R_SHOULDER_Y"),
            *("R_ELBOW_P", "R_ELBOW_Y", "R_WRIST_R", "R_WRIST_Y"),
        ),
    ),
    Case(
        "jvrc_leg",
        "jvrc_description/jvrc_description/urdf/jvrc1.urdf",
        ("L_HIP_P", "L_HIP_R", "L_HIP_Y", "L_KNEE", "L_ANKLE_R", "L_ANKLE_P"),
    ),
)

_MJCF_LIMITS = {"velocity": 2.0}
"""Velocity limit of joints of MJCF files, which cannot state one [rad/s or m/s]."""


def _mjcf(name: str, path: str, *joints: str, **lock: float) -> Case:
    return Case(name, path, joints or None, lock, _MJCF_LIMITS)


def _prefixed(prefix: str, *joints: str, suffix: str = "_joint") -> tuple[str, ...]:
    return tuple(f"{prefix}{joint}{suffix}" for joint in joints)


# MJCF files of other wheels; "_unlimited" ones state no velocity, which is refused
MJCF = (
    Case("mjcf_unlimited", f"{_ROBOSUITE}/panda/robot.xml"),
    _mjcf("mjcf_panda", f"{_ROBOSUITE}/panda/robot.xml"),
    _mjcf("mjcf_ur5e", f"{_ROBOSUITE}/ur5e/robot.xml"),
    _mjcf("mjcf_iiwa", f"{_ROBOSUITE}/iiwa/robot.xml"),
    _mjcf("mjcf_sawyer", f"{_ROBOSUITE}/sawyer/robot.xml"),
    _mjcf("mjcf_jaco", f"{_ROBOSUITE}/jaco/robot.xml"),
    _mjcf("mjcf_kinova3", f"{_ROBOSUITE}/kinova3/robot.xml"),
    _mjcf("mjcf_xarm7", f"{_ROBOSUITE}/xarm7/robot.xml"),
    _mjcf("mjcf_spot_arm", f"{_ROBOSUITE}/spot_arm/robot.xml"),
    _mjcf(
        "mjcf_baxter",
        f"{_ROBOSUITE}/baxter/robot.xml",
        *_prefixed("right_", "s0", "s1", "e0", "e1", "w0", "w1", "w2", suffix=""),
    ),
    _mjcf(
        "mjcf_tiago", f"{_ROBOSUITE}/tiago/robot.xml", *_numbered("arm_left_{}_joint", range(1, 7))
    ),
    _mjcf(
        "mjcf_gr1_arm",
        f"{_ROBOSUITE}/gr1/robot.xml",
        *("r_shoulder_pitch", "r_shoulder_roll", "r_shoulder_yaw", "r_elbow_pitch"),
        *("r_wrist_yaw", "r_wrist_roll", "r_wrist_pitch"),
    ),
    _mjcf(
        "mjcf_spot_leg",
        f"{_ROBOSUITE}/spot/robot.xml",
        *("fr_hx_leg_joint", "fr_hy_leg_joint", "fr_kn_leg_joint"),
    ),
    _mjcf("mjcf_acrobot", f"{_SUITE}/acrobot.xml"),
    _mjcf("mjcf_reacher", f"{_SUITE}/reacher.xml"),
    _mjcf(
        "mjcf_manipulator",
        f"{_SUITE}/manipulator.xml",
        *("arm_root", "arm_shoulder", "arm_elbow", "arm_wrist"),
    ),
    _mjcf(
        "mjcf_humanoid_arm",
        f"{_SUITE}/humanoid.xml",
        *("right_shoulder1", "right_shoulder2", "right_elbow"),
    ),
    _mjcf(
        "mjcf_quadruped_leg",
        f"{_SUITE}/quadruped.xml",
        *("yaw_front_left", "pitch_front_left", "knee_front_left"),
    ),
    _mjcf(
        "mjcf_pusher",
        f"{_GYM}/mujoco/assets/pusher.xml",
        *("r_shoulder_pan_joint", "r_shoulder_lift_joint", "r_upper_arm_roll_joint"),
        *("r_elbow_flex_joint", "r_forearm_roll_joint", "r_wrist_flex_joint"),
    ),
    _mjcf(
        "mjcf_shadow_finger",
        f"{_GYM}/assets/hand/reach.xml",
        *("robot0:FFJ3", "robot0:FFJ2", "robot0:FFJ1"),
    ),
    _mjcf(
        "mjcf_adroit_arm",
        f"{_GYM}/assets/adroit_hand/adroit_door.xml",
        *("ARTz", "ARRx", "ARRy", "ARRz", "WRJ1", "WRJ0"),
    ),
    _mjcf(
        "mjcf_kitchen_panda",
        f"{_GYM}/assets/kitchen_franka/kitchen_assets/kitchen_env_model.xml",
        *_numbered("robot:panda0_joint{}", range(1, 8)),
    ),
    Case(
        "mjcf_dm_jaco",
        "dm_control/dm_control/third_party/kinova/jaco_arm.xml",
        assumed=_MJCF_LIMITS | {"torque": 30.0},
    ),
)
RECORDED = (Case("emps", "emps/emps.urdf"),)
