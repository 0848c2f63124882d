"""KML 2.2 with Google's track extension: the fixes and the requested tracks, for a virtual globe."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from bench.core.files import durable
from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ExportError
from bench.io.exports.outgoing import Calendar, ExportData, thin

FORMATS = {"kml": "the fixes on a globe"}
FILE = "tracks.kml"
_KML, _GX = "http://www.opengis.net/kml/2.2", "http://www.google.com/kml/ext/2.2"
_TRACK_RATE = 10.0  # largest rate of the points of a track [Hz]


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write ``tracks.kml``; return its description for the README."""
    Xml.register_namespace("", _KML)
    Xml.register_namespace("gx", _GX)
    root = Xml.Element(f"{{{_KML}}}kml")
    document = Xml.SubElement(root, f"{{{_KML}}}Document")
    items = []
    if out.fixes is not None:
        fixes = out.select_fixes()
        _add_track(document, out.calendar, "GNSS fixes", fixes.t, fixes.lla)
        items.append(f"- GNSS fixes: the {len(fixes)} of its antenna that the receiver marks as valid")
    for name, track in out.tracks.items():
        kept = thin(track.t, _TRACK_RATE)
        kept = kept[np.isfinite(track.lla[kept]).all(axis=1)]
        _add_track(document, out.calendar, name, track.t[kept], track.lla[kept])
        items.append(f"- {name}: {len(kept)} points of the IMU, at most {_TRACK_RATE:g} per second")
    if not items:
        raise ExportError("the run has no GNSS receiver; add --with truth or --with solution:NAME")
    text = Xml.tostring(root, encoding="unicode")
    text = re.sub(r"(<(?:when|gx:coord|Placemark|Document|gx:Track)>)", r"\n\1", text)
    durable.write(folder / FILE, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')
    tracks = "\n".join(items)
    return f"""`{FILE}`: a gx:Track for each of

{tracks}

Coordinates are longitude, latitude [deg], height [m]; `when` is UTC. Heights are above the ellipsoid. A globe
takes them as above sea level, so they are off by the height of the geoid, up to 100 m."""


def _add_track(document: Xml.Element, calendar: Calendar, name: str, t: FloatArray, lla: FloatArray) -> None:
    mark = Xml.SubElement(document, f"{{{_KML}}}Placemark")
    Xml.SubElement(mark, f"{{{_KML}}}name").text = name
    track = Xml.SubElement(mark, f"{{{_GX}}}Track")
    Xml.SubElement(track, f"{{{_KML}}}altitudeMode").text = "absolute"
    for seconds in t:
        when = calendar.at(seconds)
        Xml.SubElement(track, f"{{{_KML}}}when").text = f"{when.isoformat(timespec='milliseconds')}Z"
    for lat, lon, alt in zip(*np.rad2deg(lla[:, :2]).T, lla[:, 2], strict=True):
        Xml.SubElement(track, f"{{{_GX}}}coord").text = f"{lon:.9f} {lat:.9f} {alt:.3f}"
