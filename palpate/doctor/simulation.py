"""The physics engine and the rigid-body library do their work, not only import."""

import os
from collections.abc import Iterator
from importlib import metadata

from palpate.doctor.finding import Finding, fail, ok

GRAVITY = 9.81  # [m/s2]


def pybullet() -> Iterator[Finding]:
    """A dropped body falls as it should."""
    from sim_backend.bullet import bullet as engine  # noqa: PLC0415, an import that fails is a finding

    client = engine.connect(engine.DIRECT)
    try:
        body = engine.createMultiBody(baseMass=1.0, physicsClientId=client)
        engine.setGravity(0, 0, -GRAVITY, physicsClientId=client)
        step_s = engine.getPhysicsEngineParameters(physicsClientId=client)["fixedTimeStep"]
        engine.stepSimulation(physicsClientId=client)
        speed = engine.getBaseVelocity(body, physicsClientId=client)[0][2]
    finally:
        engine.disconnect(client)
    expected = -GRAVITY * step_s
    if abs(speed - expected) > 0.01 * abs(expected):
        yield fail(
            "pybullet", f"a dropped body falls at {speed:.4f} m/s, not {expected:.4f}", "make clean env"
        )
    else:
        yield ok("pybullet", f"{metadata.version('pybullet')}, works")


def pinocchio() -> Iterator[Finding]:
    """A rigid-body model can be built and evaluated."""
    import numpy as np  # noqa: PLC0415
    import pinocchio as pin  # noqa: PLC0415

    model = pin.Model()
    model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint")
    torque = pin.rnea(model, model.createData(), np.zeros(1), np.zeros(1), np.zeros(1))
    if torque.shape != (1,):
        yield fail("pinocchio", "inverse dynamics of one joint gives no torque", "make clean env")
    else:
        yield ok("pinocchio", f"{metadata.version('pin')}, works; {os.cpu_count()} processors")
