"""Layout of the planner's scratch memory: one array of float64, shape (`size_for(m)`,) for m other vehicles, which each plan overwrites.

Allocating a dozen arrays takes a tenth of a plan. Plans stand in blocks of `LANES` lateral plans, and points in time are filled up to
whole `LANES`; what is beyond the last point is computed and never looked at.
"""

from itertools import accumulate

from drivecal.highway.planner.lanes import LANES
from drivecal.highway.planner.plans import LATERAL_PLANS, LONGITUDINAL_PLANS, POINTS

TIMES = 32
"""Points in time, filled up."""
EVERY = (1 << POINTS) - 1
"""Bits of all points."""
BLOCKS = LATERAL_PLANS // LANES

BLOCK = POINTS * 3 * LANES
"""Numbers of a block in `MOTION`: for each point d, d' and d''."""
ROW = 4 * TIMES
S, S1, SLOWNESS, BEND = (column * TIMES for column in range(4))
"""Numbers of a longitudinal plan in `ROWS`: s, s', 1 / s', and the lateral acceleration in the road's curve."""
NEAR = 5 * LANES
TOUCHING, CLEAR, AHEAD, ALONGSIDE, BEHIND = (kind * LANES for kind in range(5))
"""Numbers of a block in `NEARS`, unscaled: COLLISION, CLEARANCE, LEADER, CLOSING and FOLLOWER."""
OTHER = 5 * TIMES + LANES
OTHER_S, OTHER_D, OTHER_D1, SPACE, ENOUGH, IS_SEEN = (column * TIMES for column in range(6))
OTHER_S1, LENGTH, BREADTH, FOLLOWING = (IS_SEEN + index for index in range(1, 5))
"""Numbers of another vehicle in `OTHERS`: s, d, d'; the least space at its side that a plan leaves, and its squared share of `CLEAR_SIDE`;
whether any plan comes near it; s'; distances of the centres at which the two touch; whether it is in the wanted lane."""

_SIZES = (
    TIMES,
    TIMES,
    BLOCKS * BLOCK,
    POINTS * LANES,
    POINTS * LANES,
    6 * LATERAL_PLANS,
    2 * LONGITUDINAL_PLANS,
    LATERAL_PLANS,
    LONGITUDINAL_PLANS * ROW,
    LONGITUDINAL_PLANS,
    LATERAL_PLANS,
    LATERAL_PLANS,
    LATERAL_PLANS,
    BLOCKS * NEAR,
    3 * TIMES,
    LANES,
)
(
    TIME,
    FADING,
    MOTION,
    RIGHTMOST,
    LEFTMOST,
    LATERAL,
    LONGITUDINAL,
    ASIDE,
    ROWS,
    IS_STRAIGHT,
    STRAIGHT_SIDES,
    SIDES,
    HEADINGS,
    NEARS,
    MEETING,
    COSTS,
    OTHERS,
) = accumulate(_SIZES, initial=0)
"""Times of the points; remaining share of a neighbour's lateral speed; motion of lateral plans, and their least and largest d by lane;
features of lateral and of longitudinal plans; costs of lateral plans; longitudinal plans, and whether the road is straight along them;
LATERAL_ACCELERATION on straight roads and along the row, HEADING; sums over the neighbours; a longitudinal plan's shortfall, share
alongside and urgency with a neighbour; costs of a block;
neighbours."""


def size_for(others: int) -> int:
    """Returns the size of the scratch memory for this number of other vehicles."""
    return OTHERS + others * OTHER
