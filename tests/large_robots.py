"""URDFs of robots with many joints, without meshes."""

from __future__ import annotations


def tree_urdf(joints: int, limbs: int = 1, *, capsules: bool = False) -> str:
    """Return the URDF of a robot whose joints form serial limbs on a common base.

    Masses decrease along a limb, and torque limits hold the stretched limb, as on real arms.

    Args:
        joints: Number of joints.
        limbs: Number of limbs, of equally many joints or one more.
        capsules: True if links have collision shapes.
    """
    parts = ['<link name="base"/>']
    counts = [joints // limbs + (limb < joints % limbs) for limb in range(limbs)]
    number = 0
    for limb, count in enumerate(counts):
        parent, masses = "base", [max(0.3, 3.0 * 0.85**k) for k in range(count)]
        for k, mass in enumerate(masses):
            child, axis = f"link_{limb}_{k}", ("0 0 1", "0 1 0", "1 0 0")[k % 3]
            effort = max(5.0, 0.6 * 4.0 * 9.81 * sum(masses[k:]) * 0.12 * (count - k))
            origin = f"0 {0.4 * limb} 0" if k == 0 else "0.02 0 0.12"
            shape = (
                '<collision><origin xyz="0.01 0 0.06"/>'
                '<geometry><cylinder radius="0.02" length="0.08"/></geometry></collision>'
            )
            parts.append(
                f'<link name="{child}"><inertial><origin xyz="0.01 0.005 0.06"/>'
                f'<mass value="{mass}"/><inertia ixx="{3e-3 * mass}" ixy="0" ixz="0" '
                f'iyy="{3e-3 * mass}" iyz="0" izz="{1e-3 * mass}"/></inertial>'
                f"{shape if capsules else ''}</link>"
            )
            parts.append(
                f'<joint name="joint_{number}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{child}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>'
                f'<limit lower="-1.5" upper="1.5" velocity="3" effort="{effort}"/></joint>'
            )
            parent, number = child, number + 1
    body = "\n".join(parts)
    return f'<robot name="tree_{joints}_{limbs}">\n{body}\n</robot>\n'
