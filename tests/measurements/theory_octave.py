"""Run the three scripts of Maiga (2022), appendix 3, in Octave beside our own `printed` module.

Usage: python tests/measurements/theory_octave.py [--latitudes 45] [--days 365]

The scripts are rewritten here, one cell at a time as in the paper, so that their cost is that of the paper's. A whole
table of 66 latitudes takes over an hour, hence one latitude by default; the time of a table is scaled from it.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from solar import gain
from solar.gain import printed

TILTS = np.arange(91.0)
DECLINATION = "delta = 23.45*sind(360*(284+n)/365)*pi/180;"
HALF_DAY = "T0(n,i) = (12/pi)*acos(-tand(phi(i))*tan(delta));"
SCRIPTS = {
    "1": (
        5,
        f"""
    {DECLINATION}
    C1(n,i,j) = sin(delta)*(cosd(beta(j))*sind(phi(i)) - sind(beta(j))*cosd(phi(i))*cosd(lambda));
    C2(n,i,j) = cos(delta)*(cosd(beta(j))*cosd(phi(i)) + sind(beta(j))*sind(phi(i))*cosd(lambda));
    C3(n,i,j) = sind(beta(j))*cos(delta)*sind(lambda);
    {HALF_DAY}
    bottom = cosd(phi(i))*tan(delta) + sind(phi(i));
    root = sqrt(cotd(lambda)^2 + sind(phi(i))^2 - cosd(phi(i))^2*tan(delta)^2);
    g(n,i,j) = (24/pi)*atan((root - cotd(lambda))/bottom);
    h(n,i,j) = (24/pi)*atan((cotd(lambda) - root)/bottom);
    edges = [-T0(n,i), g(n,i,j), h(n,i,j), T0(n,i)];
    total = 0;
    for k = 1:3
      from = edges(k); to = edges(k+1);
      piece = C1(n,i,j)*(to-from) + (12/pi)*C2(n,i,j)*(sin(pi*to/12) - sin(pi*from/12));
      total = total + abs(piece - (12/pi)*C3(n,i,j)*(cos(pi*to/12) - cos(pi*from/12)));
    end
    K(n,i,j) = 2*T0(n,i)/total;
""",
    ),
    "2": (
        0,
        f"""
    {DECLINATION}
    {HALF_DAY}
    a(n,i) = sin(delta)*sind(phi(i)); b(n,i) = cos(delta)*cosd(phi(i)); c(n,i) = cos(pi*T0(n,i)/12);
    A = a(n,i); B = b(n,i); C = c(n,i);
    X1(n,i) = 1 - A^2/2 - A^4/8; X2(n,i) = -A*B*(1 + A^2/2);
    X3(n,i) = -(A^2/2)*(1 + A^2/8 + B^2); X4(n,i) = -(A*B/2)*(2 + A^2/2);
    V1(n,i,j) = X1(n,i)*(1-C) + X2(n,i)/2*(1-C^2) + X3(n,i)/3*(1-C^3) + X4(n,i)/4*(1-C^4);
    V2(n,i,j) = A*T0(n,i) + (12/pi)*B*sin(pi*T0(n,i)/12);
    K(n,i,j) = T0(n,i)/abs((12/pi)*sind(beta(j))*V1(n,i,j) + cosd(beta(j))*V2(n,i,j));
""",
    ),
    "3": (
        4,
        f"""
    {DECLINATION}
    {HALF_DAY}
    a(n,i) = sin(delta)*sind(phi(i)); b(n,i) = cos(delta)*cosd(phi(i)); c(n,i) = cos(pi*T0(n,i)/12);
    A = a(n,i); B = b(n,i); C = c(n,i); T = T0(n,i); sL = sind(lambda); cL = cosd(lambda); sB = sind(beta(j));
    top(n,i) = asin(A + B);
    d = (12/pi)*sL*sin(delta)*cosd(phi(i)); e = -(12/pi)*sL*cos(delta)*sind(phi(i));
    X1(n,i) = 1 - A^2/2 - A^4/4; X2(n,i) = -A*B*(1 + A^2/2);
    X3(n,i) = -(A^2/2)*(1 + A^2/8 + B^2); X4(n,i) = -(A*B/2)*(2 + A^2/2);
    X5(n,i) = -(A^2/4)*(1 + B^2 + 3*A^2/16 + 5/4);
    p1 = -A*sB*cL*sin(delta)*cosd(phi(i));
    p2 = -sB*cL*(B*sin(delta)*cosd(phi(i)) - A*cos(delta)*sind(phi(i)));
    p3 = B*sB*cL*cos(delta)*sind(phi(i));
    q1 = A*sB*sL*cos(delta); q2 = (B/2)*sB*sL*cos(delta);
    H1(n,i,j) = -cL*6*(top(n,i) + (A+B)*cos(top(n,i)))/(pi*cosd(phi(i)));
    H1(n,i,j) = H1(n,i,j) + d*(X1(n,i)*(1-C) + X2(n,i)/2*(1-C^2) + X3(n,i)/3*(1-C^3) + X4(n,i)/4*(1-C^4));
    H2(n,i,j) = e*(X1(n,i)/2*(1-C^2) + X2(n,i)/3*(1-C^3) + X3(n,i)/4*(1-C^4) + X4(n,i)/5*(1-C^5));
    H2(n,i,j) = H2(n,i,j) + (p1 + p3/2)*T + (3*p3/pi)*sin(pi*T/6) + (12*p2/pi)*sin(pi*T/12);
    H3(n,i,j) = -(6/pi)*(2*q1 + q2) + (12*q1/pi)*cos(pi*T/12) + (6*q2/pi)*cos(pi*T/6);
    H3(n,i,j) = H3(n,i,j) + cL*((A^2 + B^2/2)*T + (24*A*B/pi)*sin(pi*T/12) + (3*B^2/pi)*sin(pi*T/6));
    H3(n,i,j) = H3(n,i,j) + X5(n,i)*(d/5*(1-C^5) + e/6*(1-C^6));
    K(n,i,j) = T/abs(H1(n,i,j) + H2(n,i,j) + H3(n,i,j));
""",
    ),
}


def program(body: str, deviation: float, latitudes: list[float], days: int, out: Path) -> str:
    """Return an Octave program that evaluates one script cell by cell and writes its table to `out`.

    The smallest eta is taken anew for every day, as the paper's scripts do.
    """
    return f"""
lambda = {deviation}; phi = [{" ".join(map(repr, latitudes))}]; beta = 0:90;
started = tic;
for i = 1:numel(phi)
  for j = 1:91
    for n = 1:{days}
{body}
    eta(n,i,j) = K(n,i,j) - 1;
    least(i,j) = min(eta(:,i,j));
    end
  end
end
printf("seconds %.3f\\n", toc(started));
file = fopen("{out}", "w"); fprintf(file, "%.17g %.17g\\n", [real(least(:))'; imag(least(:))']); fclose(file);
"""


def main() -> int:
    """Run the scripts and print times and the largest difference."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    arguments.add_argument(
        "--latitudes", type=float, nargs="+", default=[45.0], help="latitudes in degrees (default: 45)"
    )
    arguments.add_argument("--days", type=int, default=365, help="days of the year (default: %(default)s)")
    given = arguments.parse_args()
    octave = shutil.which("octave-cli") or shutil.which("octave")
    if octave is None:
        print("Octave is not installed; on Debian: apt-get install octave", file=sys.stderr)
        return 2
    phi, days = np.array(given.latitudes)[:, None, None], np.arange(1.0, given.days + 1.0)
    cells = len(given.latitudes) * TILTS.size * given.days
    print(f"{len(given.latitudes)} latitudes, {TILTS.size} tilts, {given.days} days: {cells} cells")
    for name, (deviation, body) in SCRIPTS.items():
        with tempfile.TemporaryDirectory() as folder:
            source, out = Path(folder) / "script.m", Path(folder) / "table.txt"
            source.write_text(program(body, deviation, given.latitudes, given.days, out))
            run = subprocess.run([octave, "--norc", source], capture_output=True, text=True, check=True)
            table = np.loadtxt(out).reshape(TILTS.size, len(given.latitudes), 2)
        found = re.search(r"seconds ([\d.]+)", run.stdout)
        octave_s = float(found.group(1)) if found else float("nan")
        started = time.perf_counter()
        tilts = TILTS[:, None]
        if name == "1":
            ratio = printed.script1(phi, tilts, days, deviation).k_ds
        elif name == "2":
            ratio = printed.script2(phi, tilts, days)
        else:
            ratio = printed.script3(phi, tilts, days, deviation)
        ours = printed.least_eta(ratio)
        ours_s = time.perf_counter() - started
        difference = np.abs(ours.T - table[..., 0]) / np.abs(1.0 + table[..., 0])
        scaled = octave_s / cells * 66 * 91 * 365
        print(
            f"script {name}: Octave {octave_s:.1f} s ({scaled / 60.0:.0f} min for 66 latitudes), here {ours_s:.4f} s, "
            f"largest relative difference of K {np.nanmax(difference):.1e}"
        )
    started = time.perf_counter()
    gain.daily(phi, TILTS[:, None], days, 5.0)
    print(f"exact, all three ratios: {time.perf_counter() - started:.4f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
