"""The bits by which a load tells why it has switched itself off."""

from drivers.load import agilent6063b

# The channel status of the maker's programming guide: VF, OC, OP, OT, RV, OV, PS.
AGILENT = {
    0: "voltage fault",
    1: "over-current",
    3: "over-power",
    4: "over-temperature",
    11: "reverse voltage",
    12: "over-voltage",
    13: "protection shutdown",
}


def test_the_status_bits_of_the_agilent_6063b_mean_the_protections_of_its_manual():
    assert {1 << bit: name for bit, name in AGILENT.items()} == agilent6063b.PROTECTIONS
