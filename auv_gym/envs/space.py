"""The environments in space: those of the plane for scenarios with a vertical part."""

from __future__ import annotations

from collections.abc import Sequence

from auv_gym.envs.arguments import ScenarioLike
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.rendering import PICTURE
from auv_gym.scenarios.vehicles import VehicleLike
from auv_gym.task.model import Model
from auv_gym.task.space import SPACE


class UnderactuatedAUVTrack3DEnv(UnderactuatedAUVTrackEnv):
    """Trajectory tracking in space by a torpedo-shaped AUV with a thruster and fins for pitch and yaw.

    ## Description
    The vehicle has five degrees of freedom; the weight below the buoyancy holds the roll angle at 0. Axes are
    right-handed: x ahead, y to port, z up, so that positive theta and q mean nose down; `auv_gym.physics.space.to_ned`
    converts a state. The planner computes the only reference that a vehicle without lateral thrusters can follow, see
    `auv_gym.planning.space`, so zero error is possible in calm water. For the rest see `UnderactuatedAUVTrackEnv`.

    ## Action Space
    `Box(-1, 1, (3,), float32)`: commands as fractions of the actuator limits. Values outside are clipped.

    | Num | Action             | Min | Max | Unit at 1 |
    |-----|--------------------|-----|-----|-----------|
    | 0   | surge force F_u    | -1  | 1   | `actuators.F_u_max` [N] |
    | 1   | pitch moment F_q   | -1  | 1   | `vertical.pitch.F_q_max` [N m]; that of yaw if it has none |
    | 2   | yaw moment F_r     | -1  | 1   | `actuators.F_r_max` [N m] |

    ## Observation Space
    `Box(-bound, bound, (31,), float64)`: each term is divided by a fixed scale; `auv_gym.decode_observation` returns SI
    units.

    | Num | Term      | Unit  | Scale | Min   | Max  | Meaning |
    |-----|-----------|-------|-------|-------|------|---------|
    | 0   | e_x       | m     | 1     | -64   | 64   | position error along the axis of the body |
    | 1   | e_y       | m     | 1     | -64   | 64   | position error to port |
    | 2   | e_z       | m     | 1     | -64   | 64   | position error along the body's upward axis |
    | 3   | theta_e   | rad   | 0.5   | -2 pi | 2 pi | error of the axis in pitch, positive nose down |
    | 4   | psi_e     | rad   | 0.5   | -2 pi | 2 pi | error of the axis in yaw |
    | 5   | u_e       | m/s   | 0.5   | -32   | 32   | surge velocity error over ground |
    | 6   | v_e       | m/s   | 0.5   | -32   | 32   | sway velocity error over ground |
    | 7   | w_e       | m/s   | 0.5   | -32   | 32   | heave velocity error over ground |
    | 8   | q_e       | rad/s | 0.125 | -64   | 64   | pitch rate error |
    | 9   | r_e       | rad/s | 0.125 | -64   | 64   | yaw rate error |
    | 10  | theta_R   | rad   | 0.5   | -pi   | pi   | reference pitch |
    | 11  | u_R       | m/s   | 0.5   | -32   | 32   | reference surge velocity |
    | 12  | v_R       | m/s   | 0.5   | -32   | 32   | reference sway velocity |
    | 13  | w_R       | m/s   | 0.5   | -32   | 32   | reference heave velocity |
    | 14  | q_R       | rad/s | 0.125 | -64   | 64   | reference pitch rate |
    | 15  | r_R       | rad/s | 0.125 | -64   | 64   | reference yaw rate |
    | 16  | F_uR      | N     | 128   | -64   | 64   | reference surge force |
    | 17  | F_qR      | N m   | 64    | -64   | 64   | reference pitch moment |
    | 18  | F_rR      | N m   | 64    | -64   | 64   | reference yaw moment |
    | 19  | cos_theta | 1     | 1     | -1    | 1    | cosine of the measured pitch |
    | 20  | sin_theta | 1     | 1     | -1    | 1    | sine of the measured pitch |
    | 21  | cos_psi   | 1     | 1     | -1    | 1    | cosine of the measured heading |
    | 22  | sin_psi   | 1     | 1     | -1    | 1    | sine of the measured heading |
    | 23  | depth     | m     | 16    | -64   | 64   | measured depth below the surface |
    | 24  | F_u_max   | N     | 128   | -64   | 64   | surge force that action 1 commands |
    | 25  | F_q_max   | N m   | 64    | -64   | 64   | pitch moment that action 1 commands |
    | 26  | F_r_max   | N m   | 64    | -64   | 64   | yaw moment that action 1 commands |
    | 27  | a_u       | 1     | 1     | -1    | 1    | previous action, surge |
    | 28  | a_q       | 1     | 1     | -1    | 1    | previous action, pitch |
    | 29  | a_r       | 1     | 1     | -1    | 1    | previous action, yaw |
    | 30  | dt        | s     | 0.125 | -80   | 80   | control period |

    ## Rewards
    Those of the plane, for the position error in space.

    ## Starting State
    The reference at t = 0 plus the errors of the scenario's `start` and `vertical`, with its surge velocity.

    ## Episode End
    - Termination: the distance to the reference exceeds `lost_distance`, the vehicle is above the surface, or the pitch
      exceeds 80 degrees.
    - Truncation: after `steps` control steps.

    ## Information
    `position_error` [m], `saturated` and `time` [s], as in the plane. `env.unwrapped.state` is x, y, z [m], theta, psi
    [rad], u, v, w [m/s] over ground, q, r [rad/s].

    ## Arguments
    Those of the plane; the default scenario is `space-calm`. A `preview` appends three columns for each time, x, y, z.
    `reset(options=...)` takes `initial_error` x_e, y_e, z_e [m], theta_e, psi_e [rad], and `initial_velocity` u, v, w
    [m/s], q, r [rad/s].

    ## Version History
    - v0: initial version.
    """

    kind: Model = SPACE

    def __init__(
        self,
        scenario: ScenarioLike = "space-calm",
        vehicle: VehicleLike | None = None,
        control_dt: float | None = None,
        render_mode: str | None = None,
        preview: Sequence[int] = (),
        render_size: Sequence[int] = PICTURE,
    ) -> None:
        """See the class.

        Raises:
            ValueError: an argument is wrong, or the path cannot be planned.
        """
        super().__init__(scenario, vehicle, control_dt, render_mode, preview, render_size)


class UnderactuatedAUVTrack3DVectorEnv(UnderactuatedAUVTrackVectorEnv):
    """A vector environment of N vehicles in space; see `UnderactuatedAUVTrack3DEnv` for the task.

    Arguments and behaviour are those of `UnderactuatedAUVTrackVectorEnv`; the default scenario is `space-calm`.
    """

    kind: Model = SPACE

    def __init__(
        self, num_envs: int = 1, scenario: ScenarioLike | Sequence[ScenarioLike] = "space-calm", **options: object
    ) -> None:
        """See the class."""
        super().__init__(num_envs, scenario, **options)  # type: ignore[arg-type]
