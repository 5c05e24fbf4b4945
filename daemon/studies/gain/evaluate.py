"""Turns a request into columns of numbers, one latitude at a time, so that memory does not grow with the grid."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from daemon.studies.gain.choices import Device
from daemon.studies.gain.request import DeviceTilts, Request
from solar import gain
from solar.frames import Array
from solar.gain import printed
from solar.gain.ratios import Energies

if TYPE_CHECKING:
    from daemon.studies.gain.weather import SkySource

Columns = dict[str, Array]


def evaluate(
    request: Request, sky: "SkySource | None" = None, progress: Callable[[float], None] = lambda _share: None
) -> Columns:
    """Return one row for each latitude, tilt, azimuth deviation and day of the request, in this order.

    Ratios are those of :mod:`solar.gain`; ``..._sky`` are the same under `sky`, and ``simulated`` tells whether that
    is simulated. With `request.printed`, rows of days also have the paper's own ratios, and rows of a year the smallest
    eta over the days, as the paper's scripts print it. `progress` takes the share done, 0..1.
    """
    latitudes, blocks = request.latitudes_deg.tolist(), list[Columns]()
    for latitude in latitudes:
        blocks.append(_evaluate_latitude(request, latitude, sky))
        progress(len(blocks) / len(latitudes))
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def evaluate_points(points: Columns, *, with_printed: bool) -> Columns:
    """Return the points and their ratios, row by row; ``K_DH`` is the signed sum over the true full day."""
    phi, beta, n, deviation = points.values()
    energies = gain.daily(phi, beta, n, deviation)
    columns = points | {
        "K_DS_abs": energies.k_ds_abs,
        "K_DS_clip": energies.k_ds_clip,
        "K_DV": energies.k_dv,
        "K_DH": energies.k_dh,
    }
    if with_printed:
        columns |= _printed_days(phi, DeviceTilts(beta, beta, beta), n, deviation, tuple(Device))
    return columns


def exact_energies(latitude: float, tilts: DeviceTilts, days: Array, azimuths: Array) -> Energies:
    """Return daily energies [h], each device at its own tilt."""
    static = gain.static_energy(latitude, tilts.static, days, azimuths)
    return Energies(
        dual=2.0 * gain.half_day_h(latitude, days),
        static=static.clip_h,
        static_abs=static.abs_h,
        vertical=gain.vertical_energy_h(latitude, tilts.vertical, days),
        horizontal=gain.horizontal_energy_h(latitude, tilts.horizontal, days, azimuths),
    )


def tilts_at(request: Request, latitude: float) -> DeviceTilts:
    """Return the tilts that the request means at a latitude."""
    azimuths = request.azimuths_deg
    if request.tilts_deg is not None:
        same = np.repeat(request.tilts_deg[:, None], azimuths.size, axis=1)[..., None]
        return DeviceTilts(same, same, same)
    static = gain.best_tilt_static(latitude, azimuths).tilt_deg
    vertical = np.broadcast_to(gain.best_tilt_vertical(latitude).tilt_deg, azimuths.shape)
    horizontal = gain.best_tilt_horizontal(latitude, azimuths).tilt_deg
    return DeviceTilts(static[None, :, None], vertical[None, :, None], horizontal[None, :, None])


def _evaluate_latitude(request: Request, latitude: float, sky: "SkySource | None") -> Columns:
    tilts, azimuths = tilts_at(request, latitude), request.azimuths_deg[None, :, None]
    against, year = request.against, request.days is None
    days = gain.DAYS if request.days is None else request.days
    energies = exact_energies(latitude, tilts, days, azimuths)
    if year:
        energies = energies.apply(lambda energy: energy.sum(axis=-1, keepdims=True))
    columns: Columns = {"phi_deg": np.array(latitude)}
    if request.tilts_deg is None:
        columns |= {f"beta_{device}_deg": getattr(tilts, device.value) for device in against}
    else:
        columns["beta_deg"] = tilts.static
    columns["lambda_deg"] = azimuths
    if not year:
        columns["n"] = days
    columns |= _ratios(energies, against)
    if request.printed:
        columns |= (
            _printed_year(latitude, tilts, azimuths, against)
            if year
            else _printed_days(latitude, tilts, days, azimuths, against)
        )
    if sky is not None:
        real = sky.energies(latitude, tilts, request.azimuths_deg, request.days, against)
        columns |= {f"{name}_sky": ratio for name, ratio in _ratios(real, against).items() if name != "K_DS_abs"}
        columns["simulated"] = np.array(sky.simulated)
    shape = np.broadcast_shapes(energies.static.shape, energies.dual.shape)
    return {name: np.broadcast_to(column, shape).ravel() for name, column in columns.items()}


def _ratios(energies: Energies, against: tuple[Device, ...]) -> Columns:
    columns: Columns = {}
    if Device.STATIC in against:
        columns |= {"K_DS_abs": energies.k_ds_abs, "K_DS_clip": energies.k_ds_clip}
    if Device.VERTICAL in against:
        columns["K_DV"] = energies.k_dv
    if Device.HORIZONTAL in against:
        columns["K_DH"] = energies.k_dh
    if Device.STATIC in against and Device.VERTICAL in against:
        columns["eta_VS"] = energies.eta_vs
    if Device.STATIC in against and Device.HORIZONTAL in against:
        columns["eta_HS"] = energies.eta_hs
    return columns


def _printed_days(
    phi: Array | float, tilts: DeviceTilts, n: Array, deviation: Array, against: tuple[Device, ...]
) -> Columns:
    columns: Columns = {}
    if Device.STATIC in against:
        columns["K_DS_eq11"] = printed.k_ds_eq11(phi, tilts.static, n, deviation)
    if Device.VERTICAL in against:
        columns["K_DV_eq25"] = printed.k_dv_eq25(phi, tilts.vertical, n)
        columns["K_DV_script2"] = printed.script2(phi, tilts.vertical, n)
    if Device.HORIZONTAL in against:
        columns["K_DH_eq49"] = printed.k_dh_eq49(phi, tilts.horizontal, n, deviation)
        columns["K_DH_script3"] = printed.script3(phi, tilts.horizontal, n, deviation)
    return columns


def _printed_year(latitude: float, tilts: DeviceTilts, deviation: Array, against: tuple[Device, ...]) -> Columns:
    """Return what the scripts print for a year: the smallest eta over its days."""
    ratios: Columns = {}
    if Device.STATIC in against:
        ratios["eta_DS_script1_min"] = printed.script1(latitude, tilts.static, gain.DAYS, deviation).k_ds
    if Device.VERTICAL in against:
        ratios["eta_DV_script2_min"] = printed.script2(latitude, tilts.vertical, gain.DAYS)
    if Device.HORIZONTAL in against:
        ratios["eta_DH_script3_min"] = printed.script3(latitude, tilts.horizontal, gain.DAYS, deviation)
    return {name: printed.least_eta(ratio)[..., None] for name, ratio in ratios.items()}
