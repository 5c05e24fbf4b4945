"""The page about the house, its picture and the examples of docs/develop."""

import importlib.util
from xml.etree import ElementTree as ET

from matplotlib.font_manager import findfont
from PIL import ImageFont

from tests.support import DOCS

SCRIPT = DOCS / "develop" / "house.py"


def drawing():
    specification = importlib.util.spec_from_file_location("house_picture", SCRIPT)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_the_committed_house_picture_matches_what_its_script_draws():
    house = drawing()
    assert house.PICTURE.read_text(encoding="utf-8") == house.picture(), "run python docs/develop/house.py"


def test_the_house_picture_shows_every_daemon_package_and_all_text_fits_its_box():
    house = drawing()
    boxes = house.laid_out(house.floors())
    rooms = {path.parent.name for path in (house.ROOT / "daemon").glob("*/__init__.py")}
    assert rooms <= {box.module.removeprefix("daemon.") for box in boxes}
    wide = ImageFont.truetype(findfont("DejaVu Sans"), 115)
    assert [line for box in boxes for line in box.lines if wide.getlength(line) / 10 > box.width - 15] == []
    ET.fromstring(house.picture())
