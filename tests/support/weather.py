"""Weather files: a year that is made here."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from etendue.lighting import sun_direction

HEADING = (
    "LOCATION,Bern,-,CHE,test,066310,46.95,7.45,1.0,553.0",
    "DESIGN CONDITIONS,0",
    "TYPICAL/EXTREME PERIODS,0",
    "GROUND TEMPERATURES,0",
    "HOLIDAYS/DAYLIGHT SAVINGS,No,0,0,0",
    "COMMENTS 1,",
    "COMMENTS 2,",
    "DATA PERIODS,1,1,Data,Sunday, 1/ 1,12/31",
)


def year(number: int = 2023, leap: bool = False) -> list[str]:
    """The lines of a year's hours: the sun shines with 500 W/m^2 on 100 W/m^2 of a sky while it is up at the middle of
    the hour; hours with another sun are dark."""
    days = np.arange(f"{number}-01-01", f"{number + 1}-01-01", dtype="datetime64[D]")
    rows = []
    for day in days:
        _, month, date = str(day).split("-")
        if (month, date) == ("02", "29") and not leap:
            continue
        for hour in range(1, 25):
            middle = np.array([day + np.timedelta64(60 * hour - 90, "m")])
            up = sun_direction(46.95, 7.45, middle)[0, 2]
            lit = (100.0 + 500.0 * up, 500.0, 100.0) if up > 0.0 else (0.0, 0.0, 0.0)
            values = [10.0, 5.0, 80, 95_000, 0, 0, 300, *lit, 999_999, 999_999, 999_999, 9999, *[0] * 15]
            rows.append(f"{number},{int(month)},{int(date)},{hour},60,A," + ",".join(map(str, values)))
    return rows


def written(folder: Path, rows: list[str], heading: tuple[str, ...] = HEADING, end: str = "\n", bom: str = "") -> Path:
    path = folder / "weather.epw"
    path.write_bytes((bom + end.join([*heading, *rows]) + end).encode())
    return path
