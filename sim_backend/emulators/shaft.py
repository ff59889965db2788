"""One motor's end of a joint: alone on it, or beside a second one that turns the same joint."""

from dataclasses import replace

from sim_backend.emulators.plant import JointState, Plant


class Shaft:
    """What a motor does to its joint, from 0, and what its own sensors see of it.

    Attributes:
        beside: the other motor's end, where two turn the joint.
        torque_nm: what the motor exerts [N m].
        limp: whether the motor exerts nothing, whatever it is told.
        backwards: whether it exerts the opposite.
        slipped_rad: how far its horn has slipped on the joint [rad].
    """

    def __init__(self, plant: Plant, joint: int) -> None:
        self._plant, self._joint = plant, joint
        self.beside: Shaft | None = None
        self.torque_nm = self.slipped_rad = 0.0
        self.limp = self.backwards = False

    def exert(self, torque_nm: float) -> None:
        """What the motor is to exert from now on [N m]; with what a second one does, it moves the joint."""
        self.torque_nm = 0.0 if self.limp else -torque_nm if self.backwards else torque_nm
        self._plant.set_torque(self._joint, self._together_nm)

    @property
    def _together_nm(self) -> float:
        return self.torque_nm + (self.beside.torque_nm if self.beside else 0.0)

    def state(self) -> JointState:
        """The newest sample; what is wrong with the torque's reading is shared by both motors."""
        state = self._plant.joint(self._joint)
        if self.beside:
            off_nm = 0.5 * (state.torque_nm - self._together_nm)
            state = replace(state, torque_nm=self.torque_nm + off_nm)
        if self.slipped_rad:
            state = replace(state, position_rad=state.position_rad + self.slipped_rad)
        return state
