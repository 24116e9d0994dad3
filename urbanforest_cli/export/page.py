"""The report as one page that needs nothing but itself: no script, no font, no picture from elsewhere."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from urbanforest_cli.export.page_growth import render_growth
from urbanforest_cli.export.page_table import (
    Column,
    Row,
    chip,
    count_cell,
    decimal,
    number_cell,
    percent,
    share_cell,
    table,
    text_cell,
    whole,
    words,
)

PROVENANCE_ID = "urbanforest-provenance"

STYLE = """
:root { --ink: #2d3136; --soft: #74787b; --line: #e2ded5; --paper: #fcfbf8; --leaf: #5d8a3a; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 15px/1.5 "Inter", "Segoe UI", "Helvetica Neue", Arial, "DejaVu Sans", sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 56px 40px 72px; }
h1 { font-size: 38px; line-height: 1.15; margin: 0 0 6px; letter-spacing: -0.01em; overflow-wrap: anywhere; }
h2 { font-size: 12px; letter-spacing: .09em; text-transform: uppercase; color: var(--soft);
  margin: 52px 0 14px; font-weight: 700; }
p.lead { color: var(--soft); margin: 0; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(138px, 1fr)); gap: 0 28px; margin-top: 34px; }
.figures div { border-top: 2px solid var(--ink); padding: 10px 0 18px; }
.figures b { display: block; font-size: 26px; line-height: 1.2; font-variant-numeric: tabular-nums; font-weight: 600; }
.figures span { color: var(--soft); font-size: 13px; }
img { display: block; width: 100%; height: auto; border: 0; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; color: var(--soft); font-size: 12.5px; border-bottom: 1px solid var(--ink);
  padding: 4px 14px 6px 0; vertical-align: bottom; }
td { border-bottom: 1px solid var(--line); padding: 7px 14px 7px 0; vertical-align: top; overflow-wrap: anywhere;
  min-width: 4.8em; }
th.n, td.n { text-align: right; white-space: nowrap; }
th:last-child, td:last-child { padding-right: 0; }
td small, .soft { color: var(--soft); }
.chip { display: inline-block; width: 13px; height: 13px; border-radius: 50%; margin-right: 9px; vertical-align: -1px;
  border: 1px solid rgba(0,0,0,.28); }
.chip.box { border-radius: 2px; width: 20px; }
.band { display: flex; height: 16px; border-radius: 3px; overflow: hidden; margin: 2px 0 16px; }
.side { display: grid; grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); gap: 0 44px; margin: 18px 0; }
.side h3, h3 { font-size: 14px; margin: 18px 0 4px; }
.track { display: inline-block; position: relative; width: 150px; height: 9px; background: #ece9e1;
  border-radius: 2px; }
.track i { position: absolute; top: 0; height: 9px; background: var(--leaf); opacity: .75; border-radius: 2px; }
.track b { position: absolute; top: -2px; width: 2px; height: 13px; background: var(--ink); }
.bar.low { background: #b9b06a; margin-left: -6px; }
.bar { display: inline-block; height: 9px; background: var(--leaf); border-radius: 2px; vertical-align: 1px;
  margin-right: 8px; min-width: 1px; }
code, pre { font: 12.5px/1.5 ui-monospace, "SFMono-Regular", Menlo, Consolas, "DejaVu Sans Mono", monospace; }
pre { background: #f4f2ec; padding: 16px 18px; overflow: auto; border-radius: 4px; white-space: pre-wrap; }
details summary { cursor: pointer; color: var(--soft); }
footer { margin-top: 56px; border-top: 1px solid var(--line); padding-top: 14px; color: var(--soft); font-size: 13px; }
.none { color: var(--soft); }
@media print {
  @page { margin: 14mm; }
  body { font-size: 11px; background: #fff; } main { padding: 0; max-width: none; } h2 { margin-top: 26px; }
  tr, img, .figures div { break-inside: avoid; } h2 { break-after: avoid; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
"""


def render_html(record: Row, images: Mapping[str, bytes]) -> str:
    """Return the page of a report.

    Parameters
    ----------
    record
        As `build_report` returns it.
    images
        PNG files by name: ``map`` and, where there are any, ``view`` and ``lots``.
    """
    title = escape(record["title"])
    sections = [
        f"<h1>{title}</h1>",
        f'<p class="lead">{_lead(record)}</p>',
        _figures(record["headline"]),
        _view(images, record["title"]),
        _section("Map", _picture(images, "map", f"Map of {record['title']}: lots by zone, buildings, plants")),
        _section("Zones", table(record["zones"], _zone_columns(record["zones"]))),
        _section("Species", _species(record["species"])),
        _section("Growth", render_growth(record.get("growth"))),
        _section("Strategies", table(record["strategies"], STRATEGY_COLUMNS)),
        _section("Typical lots", _typical(images)),
        _section("Lots without plants", table(record["skipped"], SKIPPED_COLUMNS, none="Every lot was planted.")),
        _section("Warnings", table(record["warnings"], WARNING_COLUMNS, none="None.")),
        _section("Stages", table(record["stages"], STAGE_COLUMNS)),
        _section("Inputs", table(record["provenance"].get("inputs") or [], INPUT_COLUMNS, none="None.")),
        _section("Outputs", table(record.get("outputs") or [], OUTPUT_COLUMNS, none="None.")),
        _section("Config", _config(record["config"])),
    ]
    provenance = json.dumps(record["provenance"], ensure_ascii=True, allow_nan=False).replace("<", "\\u003c")
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{title}: planted city</title>
<style>{STYLE}</style>
<script type="application/json" id="{PROVENANCE_ID}">{provenance}</script>
</head>
<body>
<main>
{chr(10).join(section for section in sections if section)}
<footer>Made by urbanforest {escape(str(record["provenance"].get("program_version", "")))}.</footer>
</main>
</body>
</html>
"""


def _lead(record: Row) -> str:
    provenance = record["provenance"]
    parts = [f"urbanforest {provenance.get('program_version', '')}", f"seed {provenance.get('seed', '')}"]
    if provenance.get("working_crs"):
        parts.append(str(provenance["working_crs"]))
    return escape("  \u00b7  ".join(parts))


def _figures(headline: Row) -> str:
    shown = [
        (whole(headline["plants"]), "plants"),
        (whole(headline["trees"]), "trees"),
        (whole(headline["shrubs"]), "shrubs"),
        (whole(headline["species"]), "species"),
        (whole(headline["lots"]), "lots"),
        (whole(headline["lots_planted"]), "lots planted"),
        (whole(headline["lots_skipped"]), "lots without plants"),
        (decimal(headline["area_ha"], 1), "hectares of lots"),
        (decimal(headline["plants_per_hectare"], 1), "plants a hectare"),
        (percent(headline["crown_share"]), "crowns over lots"),
    ]
    if headline["map_share"] is not None:
        shown.append((percent(headline["map_share"]), "of the lots green in the map"))
    boxes = "".join(f"<div><b>{number}</b><span>{text}</span></div>" for number, text in shown)
    return f'<div class="figures">{boxes}</div>'


def _section(heading: str, content: str) -> str:
    return f"<section><h2>{escape(heading)}</h2>\n{content}</section>" if content else ""


def _picture(images: Mapping[str, bytes], name: str, text: str) -> str:
    if name not in images:
        return ""
    return f'<img alt="{escape(text)}" src="data:image/png;base64,{b64encode(images[name]).decode("ascii")}">'


def _view(images: Mapping[str, bytes], title: str) -> str:
    return _section("View", _picture(images, "view", f"{title} from above, with its plants as they grew"))


def _typical(images: Mapping[str, bytes]) -> str:
    picture = _picture(images, "lots", "Typical lots of each strategy and zone")
    return picture and picture + '\n<p class="soft">Yellow: the ground where plants may stand. Crowns at true size.</p>'


def _zone_columns(zones: Sequence[Row]) -> list[Column]:
    most = max((zone["plants_per_hectare"] or 0 for zone in zones), default=0) or 1

    def density(row: Row) -> str:
        width = round(90 * (row["plants_per_hectare"] or 0) / most)
        return f'<span class="bar" style="width:{width}px"></span>{decimal(row["plants_per_hectare"], 1)}'

    return [
        ("Zone", lambda row: chip(row["colour"], " box") + escape(row["zone"]), False),
        ("Lots", count_cell("lots"), True),
        ("Planted", count_cell("lots_planted"), True),
        ("Hectares", number_cell("area_ha", 1), True),
        ("Plantable", share_cell("plantable_share"), True),
        ("Plants", count_cell("plants"), True),
        ("Plants a hectare", density, True),
        ("Crowns over lots", share_cell("crown_share"), True),
        *(
            [("Green in the map", share_cell("map_share"), True)]
            if any(z["map_share"] is not None for z in zones)
            else []
        ),
    ]


SPECIES_COLUMNS: list[Column] = [
    ("Species", lambda row: chip(row["colour"]) + f"<i>{escape(row['label'])}</i>", False),
    ("Habit", text_cell("habit"), False),
    ("Plants", count_cell("plants"), True),
    ("Share", share_cell("share"), True),
    ("Mean envelope radius, m", number_cell("radius_mean_m", 2), True),
    ("Mean age, years", number_cell("age_mean_years", 1), True),
]
STRATEGY_COLUMNS: list[Column] = [
    ("Strategy", text_cell("strategy"), False),
    ("Lots", count_cell("lots"), True),
    ("Planted", count_cell("lots_planted"), True),
    ("Positions", count_cell("positions"), True),
    ("Plants", count_cell("plants"), True),
    ("Plants a planted lot", number_cell("plants_per_lot", 1), True),
    ("Mean radius asked, m", number_cell("radius_asked_m", 2), True),
    ("Mean radius got, m", number_cell("radius_realised_m", 2), True),
]
SKIPPED_COLUMNS: list[Column] = [
    ("Reason", lambda row: f"{words(row['reason'])}<br><small>{escape(row['meaning'])}</small>", False),
    ("Stage", text_cell("stage"), False),
    ("Lots", count_cell("lots"), True),
    ("Examples", lambda row: "<br>".join(_example(item) for item in row["examples"]), False),
]
WARNING_COLUMNS: list[Column] = [
    ("Stage", text_cell("stage"), False),
    ("Code", lambda row: f"<code>{escape(str(row.get('code', '')))}</code>", False),
    ("What", text_cell("message"), False),
    ("Count", count_cell("count"), True),
    ("First", lambda row: escape(", ".join(map(str, row.get("examples") or ()))), False),
]
STAGE_COLUMNS: list[Column] = [
    ("Stage", text_cell("stage"), False),
    ("Seconds", lambda row: "kept" if row.get("up_to_date") else decimal(row.get("seconds"), 1), True),
    ("Counts", lambda row: ", ".join(f"{words(k)} {_value(v)}" for k, v in (row.get("counts") or {}).items()), False),
]
INPUT_COLUMNS: list[Column] = [
    ("File", text_cell("name"), False),
    ("SHA-256", lambda row: f"<code>{escape(str(row.get('sha256', '')))}</code>", False),
]
OUTPUT_COLUMNS: list[Column] = [INPUT_COLUMNS[0], ("Bytes", count_cell("bytes"), True), INPUT_COLUMNS[1]]


def _value(value: Any) -> str:
    if isinstance(value, int) or (isinstance(value, float) and abs(value) >= 1000):
        return f"{value:,.0f}"
    return f"{value:.4g}" if isinstance(value, float) else escape(str(value))


def _example(item: Row) -> str:
    detail = f" <small>{escape(item['detail'])}</small>" if item.get("detail") else ""
    return f"{escape(item['lot_id'])}{detail}"


def _species(rows: Sequence[Row]) -> str:
    if not rows:
        return '<p class="none">No plants.</p>'
    band = "".join(
        f'<span style="background:{escape(row["colour"])};flex:{row["plants"]}" title="{escape(row["label"])}"></span>'
        for row in rows
    )
    return f'<div class="band">{band}</div>\n' + table(rows, SPECIES_COLUMNS)


def _config(config: Row) -> str:
    shown = escape(json.dumps(config, indent=2, ensure_ascii=False))
    return f"<details><summary>Every value that is set</summary><pre>{shown}</pre></details>"
