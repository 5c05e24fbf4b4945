// Directions from the two angles, as solar/frames.py has them: i to the equator's side, j east, k up.

const RAD = Math.PI / 180;

// Returns [east, north, up] of the module's normal.
export function normal(aDeg, bDeg, latitudeDeg) {
  const a = aDeg * RAD;
  const b = bDeg * RAD;
  const equatorward = Math.cos(a) * Math.cos(b);
  return [-Math.sin(a), latitudeDeg >= 0 ? -equatorward : equatorward, Math.cos(a) * Math.sin(b)];
}

// Returns the direction of the module's edge that rotation A moves.
export function edge(aDeg, bDeg, latitudeDeg) {
  const a = aDeg * RAD;
  const b = bDeg * RAD;
  const equatorward = -Math.sin(a) * Math.cos(b);
  return [-Math.cos(a), latitudeDeg >= 0 ? -equatorward : equatorward, -Math.sin(a) * Math.sin(b)];
}

export function direction(azimuthDeg, elevationDeg) {
  const flat = Math.cos(elevationDeg * RAD);
  return [Math.sin(azimuthDeg * RAD) * flat, Math.cos(azimuthDeg * RAD) * flat, Math.sin(elevationDeg * RAD)];
}

export function azimuthElevation([east, north, up]) {
  const azimuth = (Math.atan2(east, north) / RAD + 360) % 360;
  return { azimuth, elevation: Math.atan2(up, Math.hypot(east, north)) / RAD };
}

export function separationDeg(u, v) {
  const c = cross(u, v);
  return Math.atan2(Math.hypot(...c), dot(u, v)) / RAD;
}

export const dot = (u, v) => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
export const cross = (u, v) => [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];

// Returns where the sun stands on a path of {time, azimuth_deg, elevation_deg}; null outside of it.
export function sunAt(path, ms) {
  if (!path) return null;
  const times = path.map((point) => Date.parse(point.time));
  const after = times.findIndex((time) => time > ms);
  if (after < 1) return null;
  const share = (ms - times[after - 1]) / (times[after] - times[after - 1]);
  const [from, to] = [path[after - 1], path[after]];
  const turn = ((to.azimuth_deg - from.azimuth_deg + 540) % 360) - 180;
  return {
    azimuth: (from.azimuth_deg + share * turn + 360) % 360,
    elevation: from.elevation_deg + share * (to.elevation_deg - from.elevation_deg),
  };
}
