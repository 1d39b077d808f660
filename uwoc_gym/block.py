"""How simulations lie in memory: blocks of 32 lanes, each quantity a row of its block.

The rows of a block are a constant distance apart, so that the compiler can prove that loops over lanes have no
overlapping reads and writes, and vectorises them. Eight unused doubles at the end of each row keep rows from falling
into the same few cache sets when only one lane is in use. Lane j of row R of the block at ``base`` is element
``base + R * STRIDE + j``.
"""

LANES = 32
"""Simulations in a block: few enough for its rows to fit into the first-level cache."""

STRIDE = LANES + 8
"""Doubles from one row to the next."""

# fmt: off
# The AUV's state, its force and its equation of motion divided by its masses.
(
    X, Y, YAW, COS, SIN, SURGE, SWAY, YAW_RATE,
    PUSH_SURGE, PUSH_SWAY, PUSH_YAW,
    LINEAR_SURGE, LINEAR_SWAY, LINEAR_YAW,
    QUADRATIC_SURGE, QUADRATIC_SWAY, QUADRATIC_YAW,
    COUPLING_SURGE, COUPLING_SWAY, COUPLING_YAW,
    INVERSE_SURGE, INVERSE_SWAY, INVERSE_YAW,
) = range(0, 23)

# What pulses add: accelerations in the body frame, forces in the earth frame; and the current.
(
    EXTRA_SURGE, EXTRA_SWAY, EXTRA_YAW, EARTH_X, EARTH_Y, CURRENT_X, CURRENT_Y,
) = range(23, 30)

# Book-keeping of the episode.
(
    TIME, STEP, EPISODE, KEY_0, KEY_1, ENDED, LAST_OUTSIDE, ACTION_SURGE, ACTION_SWAY, ACTION_YAW,
) = range(30, 40)

# The ship's motion.
(
    SHIP_X, SHIP_Y, SHIP_YAW, SHIP_COS, SHIP_SIN, SHIP_VX, SHIP_VY, SHIP_YAW_RATE,
    SHIP_AX, SHIP_AY, SHIP_YAW_ACCELERATION,
) = range(40, 51)

# The ship's path: kind, straight part, heading, and three harmonics of four rows each.
(
    PATH_KIND, PATH_X, PATH_Y, PATH_VX, PATH_VY,
    HEADING, HEADING_RATE, SWING, SWING_RATE, SWING_PHASE, HARMONIC,
) = range(51, 62)
HARMONICS = 3
HARMONIC_ROWS = 4

# The link's coefficients.
(
    LN_RATE, SLOPE_LOG, SLOPE_LINEAR, SLOPE_COS, DEPTH, LN_DEPTH, COS_FOV, SLANT, LEVEL_SCALE,
) = range(76, 85)

# Measurement errors of pose and velocity in this step.
(
    ERROR_X, ERROR_Y, ERROR_YAW, ERROR_SURGE, ERROR_SWAY, ERROR_YAW_RATE,
) = range(85, 91)

# What a step measures; these rows are copied out after each step, in this order.
(
    BIT_RATE, SNR, BER, RANGE, POINTING_ERROR, IN_CONE, COST,
    TERM_BIT_RATE, TERM_IN_CONE, TERM_POSITION, TERM_HEADING, TERM_EFFORT,
    SUCCESS, REWARD, TERMINATED, TRUNCATED,
) = range(91, 107)
FIRST_MEASURE = BIT_RATE
MEASURES = 16

# The bit rate between threshold and on-axis rate on a log scale; whether the lane's episode had ended before.
LEVEL, WAS_ENDED = range(107, 109)

# A lawn-mower path.
LEGS_COURSE, LEGS_LENGTH, LEGS_SPACING, LEGS_SPEED, LEGS_SIDE = range(109, 114)

FIRST_PARAMETER = 114
"""First of the rows that hold what the episode drew for each number of the scenario."""
# fmt: on
