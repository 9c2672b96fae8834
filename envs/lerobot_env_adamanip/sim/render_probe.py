"""Test render. ``python -m lerobot_env_adamanip.sim.render_probe [cuda|cpu ...]`` prints the first device that works.

`sapien.Device.can_render()` returns False for Mesa's lavapipe, although it renders. Run this in its own process,
because a broken driver may crash instead of raising.
"""

from __future__ import annotations

import sys

SIZE = 32
"""Side length of the probe's image [px]."""


def render_box(backend: str) -> str:
    """Renders a red box on ``backend`` ("cuda" or "cpu"); returns SAPIEN's name of the device.

    Raises:
        RuntimeError: the device does not exist, the driver failed, or the image does not show the box.
    """
    import sapien

    device = sapien.Device(backend)
    scene = sapien.Scene([sapien.physx.PhysxCpuSystem(), sapien.render.RenderSystem(device)])
    scene.set_ambient_light([0.5, 0.5, 0.5])
    box = scene.create_actor_builder()
    box.add_box_visual(half_size=[0.1, 0.1, 0.1], material=[1.0, 0.0, 0.0])
    box.build_static(name="box")
    camera = scene.add_camera("probe", SIZE, SIZE, 1.0, 0.01, 10.0)
    camera.entity.set_pose(sapien.Pose([-0.5, 0.0, 0.0]))
    scene.update_render()
    camera.take_picture()
    red, green, blue = (float(v) for v in camera.get_picture("Color")[SIZE // 2, SIZE // 2, :3])
    if not red > 0.2 > max(green, blue):
        raise RuntimeError(f"{backend}: the rendered box is not red: {red:.2f}, {green:.2f}, {blue:.2f}")
    return f"{backend} ({device.name})" if device.name != backend else backend


def main() -> int:
    """Tries the given devices, by default the GPU, then the CPU; returns exit status 0 if one renders."""
    failures = []
    for backend in sys.argv[1:] or ("cuda", "cpu"):
        try:
            sys.stdout.write(f"{render_box(backend)}\n")
        except (RuntimeError, ImportError) as error:
            failures.append(f"{backend}: {error}")
        else:
            return 0
    sys.stderr.write("; ".join(failures) + "\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
