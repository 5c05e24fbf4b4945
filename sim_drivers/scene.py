"""The simulated scene: a sun, a sky and a ground around the cube and the module, and the cube's four sensors.

The scene is computed in chunks of one hour at one-second steps, all faces at once, and read by linear interpolation,
so that a reading costs microseconds. Chunks begin at whole hours: the scene of an instant does not depend on what was
asked before. Only the sensors' noise is drawn reading by reading.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import inf, isnan
from typing import NamedTuple

import numpy as np

from sim_drivers.weather import Weather
from solar.ephemeris import Site, extraterrestrial_dni, sun_direction, sun_position
from solar.frames import Array, normal_from_angles
from solar.skies.sky import Sky, SkyModel, normal_from_tilt, sky

CHUNK_S = 3600
KEPT_CHUNKS = 4
NOISE_BLOCK = 4096
_SKY_PARTS = tuple(field.name for field in fields(Sky))


class FaceGeometry(NamedTuple):
    """Where a face of the cube looks: azimuth from North clockwise, tilt from the horizontal [deg]."""

    azimuth_deg: float
    tilt_deg: float


@dataclass(frozen=True, slots=True)
class SensorModel:
    """What the simulated irradiance sensors do wrong.

    Attributes
    ----------
    volt_per_w_m2
        Nominal sensitivity: 0.1 mV per W/m2 for the RG100.
    gain_error
        Standard deviation of the sensors' relative gain errors, drawn once per sensor.
    noise_mv
        Standard deviation of the noise of one reading.
    cosine_error
        Beam that is missing at 80 deg of incidence, as a share of the beam. The error stays below it up to there, as
        the paper says of the RG100 (less than 1 %), and grows by as much again with each further degree.
    """

    volt_per_w_m2: float = 1e-4
    gain_error: float = 0.005
    noise_mv: float = 0.02
    cosine_error: float = 0.008

    def response(self, cosine: Array) -> Array:
        """Return the share of the beam that is sensed at a cosine of incidence."""
        incidence_deg = np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))
        return 1.0 - self.cosine_error * (
            np.minimum(incidence_deg / 80.0, 1.0) ** 4 + np.maximum(incidence_deg - 80.0, 0.0)
        )


PERFECT_SENSORS = SensorModel(gain_error=0.0, noise_mv=0.0, cosine_error=0.0)


class FaceIrradiances(NamedTuple):
    """What truly falls on the faces [W/m2]."""

    east_w_m2: float
    south_w_m2: float
    west_w_m2: float
    zenith_w_m2: float


class SunAngles(NamedTuple):
    """Where the sun truly stands, apparent [deg]; the azimuth is from North clockwise."""

    azimuth_deg: float
    elevation_deg: float


class SkyState(NamedTuple):
    """The true sky at one instant: irradiances [W/m2]."""

    ghi_w_m2: float
    dni_w_m2: float
    dhi_w_m2: float


@dataclass(frozen=True, slots=True)
class _Chunk:
    """The scene on the seconds of one hour, both ends included; NaN where there is no weather.

    Lists, not arrays: reading one number out of a list is several times faster.
    """

    sky: Sky
    faces_w_m2: list[list[float]]
    sensed_w_m2: list[list[float]]
    wind_m_s: list[float]
    air_c: list[float]


class Scene:
    """Everything around the instruments that they can sense.

    Parameters
    ----------
    site
        Where the rig stands.
    weather
        Generated or measured weather. Its GHI is not used: the sky closes GHI as DNI sin(elevation) + DHI.
    sky_model, albedo
        How diffuse light is spread over the vault, and the reflectivity of the ground.
    seed
        Fixes the sensors' gain errors and noise.
    sensors
        The imperfections of the cube's sensors.
    faces
        East, south, west, zenith; by default :func:`default_faces`.

    Raises
    ------
    WeatherError
        From every question about an instant by day for which `weather` has no data; nights are dark without it.
    """

    def __init__(
        self,
        site: Site,
        weather: Weather,
        *,
        sky_model: SkyModel = "perez1990",
        albedo: float = 0.2,
        seed: int = 1,
        sensors: SensorModel | None = None,
        faces: Sequence[FaceGeometry] | None = None,
    ) -> None:
        self._site = site
        self._weather = weather
        self._sky_model = sky_model
        self._albedo = albedo
        self._sensors = SensorModel() if sensors is None else sensors
        faces = default_faces(site.latitude_deg) if faces is None else faces
        if len(faces) != 4:
            raise ValueError(f"a cube has four faces (east, south, west, zenith), not {len(faces)}")
        self._normals = np.array(
            [normal_from_tilt(face.tilt_deg, face.azimuth_deg, site.latitude_deg) for face in faces]
        )
        self._random = np.random.default_rng(seed)
        gains = 1.0 + self._sensors.gain_error * self._random.standard_normal(4)
        self._volt_per_w_m2 = [float(gain) * self._sensors.volt_per_w_m2 for gain in gains]
        self._noise_v: list[float] = []
        self._shade = [1.0] * 4
        self._broken_v: list[float | None] = [None] * 4
        self._chunks: dict[int, _Chunk] = {}
        self._latest: _Chunk
        self._latest_utc_s = inf

    def sensor_voltage(self, face: int, utc_s: float) -> float:
        """Return what the sensor of `face` (0 east, 1 south, 2 west, 3 zenith) gives at `utc_s` [V]."""
        broken_v = self._broken_v[face]
        if broken_v is not None:
            return broken_v
        chunk, index, share = self._locate(utc_s)
        values = chunk.sensed_w_m2[face]
        sensed = values[index] + (values[index + 1] - values[index]) * share
        if isnan(sensed):
            sensed = self._compute_instant(utc_s).sensed_w_m2[face][0]
        if not self._noise_v:
            self._noise_v = (self._random.standard_normal(NOISE_BLOCK) * (1e-3 * self._sensors.noise_mv)).tolist()
        return sensed * self._shade[face] * self._volt_per_w_m2[face] + self._noise_v.pop()

    def irradiances(self, utc_s: float) -> FaceIrradiances:
        """Return what truly falls on the four faces, shade included."""
        chunk, index, share = self._locate(utc_s)
        falling = [face[index] + (face[index + 1] - face[index]) * share for face in chunk.faces_w_m2]
        if any(map(isnan, falling)):
            falling = [face[0] for face in self._compute_instant(utc_s).faces_w_m2]
        return FaceIrradiances(*(value * shade for value, shade in zip(falling, self._shade, strict=True)))

    def sun_angles(self, utc_s: float) -> SunAngles:
        """Return where the sun stands, with weather or without."""
        sun = sun_position(utc_s, *self._site)
        return SunAngles(float(sun.azimuth_deg), float(sun.elevation_deg))

    def sky_state(self, utc_s: float) -> SkyState:
        """Return the true sky."""
        now = self._sky_at(utc_s)
        return SkyState(
            ghi_w_m2=float(now.ghi_w_m2),
            dni_w_m2=float(now.dni_w_m2),
            dhi_w_m2=float(now.dhi_w_m2),
        )

    def plane_of_array(self, a_deg: float, b_deg: float, utc_s: float) -> float:
        """Return the irradiance on a module at tracker angles A and B [deg], in W/m2."""
        normal = normal_from_angles(a_deg, b_deg)
        return float(self._sky_at(utc_s).irradiance_on(normal, self._albedo))

    def wind_speed(self, utc_s: float) -> float | None:
        """Return the wind speed [m/s], or None where the weather does not tell."""
        chunk, index, share = self._locate(utc_s)
        return _between(chunk.wind_m_s, index, share)

    def air_temperature(self, utc_s: float) -> float | None:
        """Return the temperature of the air [degC], or None where the weather does not tell."""
        chunk, index, share = self._locate(utc_s)
        return _between(chunk.air_c, index, share)

    def shade(self, face: int, factor: float) -> None:
        """Let only `factor` (0..1) of the light reach a face from now on; 1 takes the shade away."""
        if not 0.0 <= factor <= 1.0:
            raise ValueError(f"a shade lets a share of 0 to 1 of the light through, not {factor}")
        self._shade[face] = factor

    def break_sensor(self, face: int, stuck_at_v: float = 0.0) -> None:
        """Make a sensor give the same voltage whatever falls on it: 0 V is a short or a cut cable."""
        self._broken_v[face] = stuck_at_v

    def repair_sensor(self, face: int) -> None:
        """Make a broken sensor work again."""
        self._broken_v[face] = None

    def _locate(self, utc_s: float) -> tuple[_Chunk, int, float]:
        """Find the chunk of an instant, the whole second before it there, and how much of the next has passed."""
        # Nearly every question is about the chunk of the one before.
        offset = utc_s - self._latest_utc_s
        if 0.0 <= offset < CHUNK_S:
            index = int(offset)
            return self._latest, index, offset - index
        number, offset = divmod(utc_s, CHUNK_S)
        chunk = self._chunks.get(int(number))
        if chunk is None:
            chunk = self._compute(int(number) * CHUNK_S + np.arange(CHUNK_S + 1.0))
            self._chunks[int(number)] = chunk
            if len(self._chunks) > KEPT_CHUNKS:
                del self._chunks[next(iter(self._chunks))]
        self._latest, self._latest_utc_s = chunk, number * CHUNK_S
        index = int(offset)
        return chunk, index, offset - index

    def _sky_at(self, utc_s: float) -> Sky:
        chunk, index, share = self._locate(utc_s)
        hour = {name: getattr(chunk.sky, name) for name in _SKY_PARTS}
        now = {name: part[index] + (part[index + 1] - part[index]) * share for name, part in hour.items()}
        if isnan(now["dhi_w_m2"]):
            beside = self._compute_instant(utc_s).sky
            now = {name: getattr(beside, name)[0] for name in _SKY_PARTS}
        return Sky(**now)

    def _compute_instant(self, utc_s: float) -> _Chunk:
        """Compute one instant that a hole in the weather keeps from being interpolated."""
        instant = np.array([utc_s])
        found = self._compute(instant)
        if isnan(found.faces_w_m2[0][0]):
            # Raises, with the reason, for an instant inside the hole.
            self._weather.at(instant)
        return found

    def _compute(self, utc_s: Array) -> _Chunk:
        covered = self._weather.covers(utc_s)
        sun = sun_direction(utc_s, *self._site)
        dni, dhi, wind, air = np.full((4, utc_s.size), np.nan)
        # Whatever the weather is at night, there is no light in it.
        dark = ~covered & (sun[:, 2] < 0.0)
        dni[dark] = dhi[dark] = 0.0
        if covered.any():
            conditions = self._weather.at(utc_s[covered])
            dni[covered], dhi[covered] = conditions.dni_w_m2, conditions.dhi_w_m2
            wind[covered], air[covered] = conditions.wind_speed_m_s, conditions.temp_air_degc
        overhead = sky(self._sky_model, sun, dni, dhi, extraterrestrial_dni(utc_s))
        normals = self._normals[:, None, :]
        falling = overhead.irradiance_on(normals, self._albedo)
        missed = 1.0 - self._sensors.response(np.sum(normals * overhead.sun, axis=-1))
        sensed = falling - overhead.beam_on(normals) * missed
        return _Chunk(
            sky=overhead,
            faces_w_m2=falling.tolist(),
            sensed_w_m2=sensed.tolist(),
            wind_m_s=wind.tolist(),
            air_c=air.tolist(),
        )


def _between(values: list[float], index: int, share: float) -> float | None:
    before = values[index]
    value = before + (values[index + 1] - before) * share
    return None if isnan(value) else value


def default_faces(latitude_deg: float) -> tuple[FaceGeometry, FaceGeometry, FaceGeometry, FaceGeometry]:
    """Return the cube's faces; the equator's face is the south face, which looks North in the southern hemisphere."""
    equator_azimuth_deg = 180.0 if latitude_deg >= 0 else 0.0
    return (
        FaceGeometry(90.0, 90.0),
        FaceGeometry(equator_azimuth_deg, 90.0),
        FaceGeometry(270.0, 90.0),
        FaceGeometry(equator_azimuth_deg, 0.0),
    )
