"""Why a law points where it does, in words for persons."""

from solar.frames import Angles, normal_from_angles, separation_deg

_POINTS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
# Noise of the faces tilts the direction of an even sky by up to this, which costs 0.4 % at most.
_EVEN_WITHIN_DEG = 5.0


def point_of_compass(azimuth_deg: float) -> str:
    """Return the nearest of eight points."""
    return _POINTS[round(azimuth_deg / 45.0) % len(_POINTS)]


def describe_direction(azimuth_deg: float, elevation_deg: float) -> str:
    """Return a direction as a person would show it."""
    return f"the {point_of_compass(azimuth_deg)}, {elevation_deg:z.0f} deg up"


def light_reason(azimuth_deg: float, elevation_deg: float) -> str:
    """Return where the light comes from, or that it comes from everywhere."""
    if elevation_deg >= 90.0 - _EVEN_WITHIN_DEG:
        return "the sky is even: lying flat collects most"
    return f"most light comes from {describe_direction(azimuth_deg, elevation_deg)}"


def sun_reason(azimuth_deg: float, elevation_deg: float) -> str:
    """Return where the faces see the sun, or that they see none: then the direction is the zenith."""
    if elevation_deg >= 90.0 - _EVEN_WITHIN_DEG:
        return "no sun is seen, or it is overhead: lying flat collects most"
    return f"the faces see the sun in {describe_direction(azimuth_deg, elevation_deg)}"


def shade_reason(wanted: Angles, target: Angles, reason: str) -> str:
    """Return the reason, with how far the tracker is turned from the wanted pose to be out of the rows' shade."""
    turned_deg = float(separation_deg(normal_from_angles(*wanted), normal_from_angles(*target)))
    told = f"turned back by {turned_deg:.0f} deg so that no row shades another"
    return f"{reason}; {told}" if reason else told


def move_reason(gain_w_m2: float, price_w_m2: float, *, moves: bool, hindered: str = "") -> str:
    """Return what a move would gain and what it costs in wear, as the law `optimal` weighs them, or what forbids it."""
    gain, price = f"{gain_w_m2:.1f}", f"{price_w_m2:.1f}"
    if hindered:
        return f"{gain} W/m2 to gain, but {hindered}"
    if moves:
        return f"{gain} W/m2 to gain, more than the wear of a move costs ({price})"
    return f"{gain} W/m2 to gain, not worth a move (from {price})"
