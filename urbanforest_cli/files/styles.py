"""QGIS styles inside the register, so that it opens looking right.

Each layer gets one categorised style as a row of ``layer_styles``, the table QGIS looks for in a GeoPackage. A style
that a user saved there stays, and stays the default where it was.
"""

from __future__ import annotations

import json
import re
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from urbanforest_cli.core import config as settings
from urbanforest_cli.core.colours import mixed, species_colour, to_rgb, zone_colour
from urbanforest_cli.core.errors import ConfigError
from urbanforest_cli.core.zones import ZONES
from urbanforest_cli.files.species import load_catalogue

STYLE_NAME = "urbanforest"
TABLE = "layer_styles"
GEOMETRY_COLUMN = "geom"
CATEGORIES_LIMIT = 500
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

_CREATE = """
CREATE TABLE IF NOT EXISTS layer_styles (
    id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    f_table_catalog TEXT(256), f_table_schema TEXT(256), f_table_name TEXT(256), f_geometry_column TEXT(256),
    styleName TEXT(30), styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN, description TEXT, owner TEXT(30),
    ui TEXT(30), update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now'))
)
"""
_COUNT_TRIGGERS = (
    """
CREATE TRIGGER IF NOT EXISTS trigger_insert_feature_count_layer_styles AFTER INSERT ON layer_styles
BEGIN UPDATE gpkg_ogr_contents SET feature_count = feature_count + 1
WHERE lower(table_name) = lower('layer_styles'); END
""",
    """
CREATE TRIGGER IF NOT EXISTS trigger_delete_feature_count_layer_styles AFTER DELETE ON layer_styles
BEGIN UPDATE gpkg_ogr_contents SET feature_count = feature_count - 1
WHERE lower(table_name) = lower('layer_styles'); END
""",
)

TREE_TIP = (
    '<b>[% "species" %]</b>, [% round("age_years") %] years<br>'
    '[% round("height_m", 1) %] m high, crown [% round(2 * "crown_radius_m", 1) %] m wide, '
    'stem [% round(100 * "dbh_m") %] cm<br>'
    "[% \"grown\" %][% coalesce(': ' || \"reason\", '') %]"
)
"""What QGIS shows of a grown plant under the mouse."""

REGION_TIP = (
    '<b>[% "lot_id" %]</b><br>[% round("inside_m2") %] m² of vegetation in the lot, '
    '[% round("area_m2" - "inside_m2") %] m² over its border, in [% "region_count" %] regions'
)
"""What QGIS shows of a lot's regions under the mouse."""

Category = tuple[str, str, str]
"""Value, label and colour."""


def write_styles(path: Path, layers: list[str]) -> None:
    """Write the default styles of the layers named into ``layer_styles``.

    Layers without a style here, and those that are not in the file, are left alone. Colours are those of the config
    that made the layers, which the file itself holds.
    """
    with closing(sqlite3.connect(path)) as register:
        wanted = [name for name in layers if name in _STYLES and _can_be_styled(register, name)]
        if not wanted:
            return
        config = _config_inside(register)
        with register:
            _make_table(register)
            for name in wanted:
                _replace_style(register, name, _STYLES[name][1](register, config))


def write_crowns_style(path: Path, layer: str, categories: Sequence[Category]) -> None:
    """Write the default style of a layer of grown plants that is not a register's: crowns as wide as they are.

    Parameters
    ----------
    categories
        Id, label and colour of each species.
    """
    symbol = partial(_crown_symbol, radius="crown_radius_m")
    rest = ("#6f8f5f", "any other species")
    qml = _qml("species", categories, symbol, rest=rest, order_by="height_m", tip=TREE_TIP)
    with closing(sqlite3.connect(path)) as register, register:
        _make_table(register)
        _replace_style(register, layer, qml)


def _can_be_styled(register: sqlite3.Connection, name: str) -> bool:
    columns = {row[0] for row in register.execute("SELECT name FROM pragma_table_info(?)", (name,))}
    return {_STYLES[name][0], GEOMETRY_COLUMN} <= columns


def _make_table(register: sqlite3.Connection) -> None:
    register.execute(_CREATE)
    newest = register.execute("SELECT max(last_change) FROM gpkg_contents").fetchone()[0]
    register.execute(
        "INSERT OR IGNORE INTO gpkg_contents (table_name, data_type, identifier, description, last_change, srs_id) "
        "VALUES (?, 'attributes', ?, 'styles of the layers, for QGIS', ?, 0)",
        (TABLE, TABLE, newest),
    )
    if register.execute("SELECT count(*) FROM sqlite_master WHERE name = 'gpkg_ogr_contents'").fetchone()[0]:
        register.execute(
            "INSERT OR IGNORE INTO gpkg_ogr_contents (table_name, feature_count) "
            "VALUES (?, (SELECT count(*) FROM layer_styles))",
            (TABLE,),
        )
        for trigger in _COUNT_TRIGGERS:
            register.execute(trigger)


def _replace_style(register: sqlite3.Connection, layer: str, qml: str) -> None:
    own = "f_table_name = ? AND styleName = ?"
    ids = [row[0] for row in register.execute(f"SELECT id FROM {TABLE} WHERE {own}", (layer, STYLE_NAME))]
    register.execute(f"DELETE FROM {TABLE} WHERE {own}", (layer, STYLE_NAME))
    others = register.execute(
        f"SELECT count(*) FROM {TABLE} WHERE f_table_name = ? AND useAsDefault", (layer,)
    ).fetchone()[0]
    changed = register.execute("SELECT last_change FROM gpkg_contents WHERE table_name = ?", (layer,)).fetchone()[0]
    register.execute(
        f"INSERT INTO {TABLE} (id, f_table_catalog, f_table_schema, f_table_name, f_geometry_column, styleName, "
        "styleQML, styleSLD, useAsDefault, description, owner, ui, update_time) "
        "VALUES (?, '', '', ?, ?, ?, ?, '', ?, 'written by urbanforest', '', NULL, ?)",
        (ids[0] if ids else None, layer, GEOMETRY_COLUMN, STYLE_NAME, qml, int(others == 0), changed),
    )


def _config_inside(register: sqlite3.Connection) -> dict[str, Any]:
    """Return the config in a register's provenance, that of later stages over that of earlier ones; {} if none."""
    try:
        rows = register.execute("SELECT config FROM provenance ORDER BY rowid").fetchall()
    except sqlite3.OperationalError:  # no table of that name: not a register, or one that is just begun
        return {}
    config: dict[str, Any] = {}
    for (text,) in rows:
        try:
            found = json.loads(text)
        except (TypeError, ValueError):
            continue
        if isinstance(found, dict):
            config |= found
    return config


def _zone_colours(config: Mapping[str, Any]) -> dict[str, str]:
    zones = config.get("zones") or {}
    return {name: table["colour"] for name, table in zones.items() if isinstance(table, dict) and table.get("colour")}


def _values(register: sqlite3.Connection, layer: str, column: str) -> list[str]:
    query = f"SELECT {column}, count(*) FROM {layer} WHERE {column} IS NOT NULL GROUP BY 1 ORDER BY 1 LIMIT ?"
    return [str(row[0]) for row in register.execute(query, (CATEGORIES_LIMIT,))]


def _lots_style(register: sqlite3.Connection, config: Mapping[str, Any]) -> str:
    chosen = _zone_colours(config)
    names = list(dict.fromkeys([*ZONES, *_values(register, "lots", "zone")]))
    categories = [(name, name, zone_colour(name, chosen)) for name in names]
    return _qml("zone", categories, _fill_symbol, rest=("#eeeeee", "any other zone"))


def _active_areas_style(register: sqlite3.Connection, config: Mapping[str, Any]) -> str:
    colours = {"lot": "#f2c14e", "road": "#8fb8a8", "region": "#7fb069", "sketch": "#d98cb3"}
    names = list(dict.fromkeys([*colours, *_values(register, "active_areas", "kind")]))
    categories = [(name, name, species_colour(name, colours)) for name in names]
    return _qml("kind", categories, _area_symbol, rest=("#f2c14e", "any other kind"))


def _regions_style(register: sqlite3.Connection, config: Mapping[str, Any]) -> str:
    return _qml("coverage", [], _region_symbol, rest=("#4f8f3a", "vegetation of the coverage map"), tip=REGION_TIP)


def _observed_style(register: sqlite3.Connection, config: Mapping[str, Any]) -> str:
    """Known plants as rings: as wide as their crowns, a metre's radius where that is unknown."""
    symbol = partial(_ring_symbol, radius="crown_radius_m")
    return _qml("observed_id", [], symbol, rest=("#c8553d", "known plants, kept as they are"))


def _plants_style(register: sqlite3.Connection, config: Mapping[str, Any]) -> str:
    categories = _species_categories(register, config, "plants")
    symbol = partial(_crown_symbol, radius="envelope_radius_m")
    return _qml("species", categories, symbol, rest=("#6f8f5f", "any other species"))


def _trees_style(register: sqlite3.Connection, config: Mapping[str, Any]) -> str:
    """Crowns as they grew, low ones under high ones; what died or did not grow has none."""
    categories = _species_categories(register, config, "trees")
    symbol = partial(_crown_symbol, radius="crown_radius_m")
    return _qml("species", categories, symbol, rest=("#6f8f5f", "any other species"), order_by="height_m", tip=TREE_TIP)


def _buildings_style(register: sqlite3.Connection, config: Mapping[str, Any]) -> str:
    return _qml("building_id", [], _building_symbol, rest=("#d9d5cc", "buildings"))


def _roads_style(register: sqlite3.Connection, config: Mapping[str, Any]) -> str:
    return _qml("road_id", [], _road_symbol, rest=("#e9e7e2", "roads"))


def _species_categories(register: sqlite3.Connection, config: Mapping[str, Any], layer: str) -> list[Category]:
    try:
        table = config.get("species") or {}
        catalogue = load_catalogue(settings.Species(folder=table.get("folder")))
    except ConfigError:  # the folder of the user's species has gone since: the shipped ones still have their colours
        catalogue = load_catalogue(settings.Species())
    known = {item.id: item for item in catalogue}
    colours = {item.id: item.colour for item in catalogue}
    categories = []
    for name in dict.fromkeys([*known, *_values(register, layer, "species")]):
        label = f"{known[name].scientific_name} ({known[name].common_name})" if name in known else name
        categories.append((name, label, species_colour(name, colours)))
    return categories


_STYLES: dict[str, tuple[str, Callable[[sqlite3.Connection, Mapping[str, Any]], str]]] = {
    "lots": ("zone", _lots_style),
    "active_areas": ("kind", _active_areas_style),
    "regions": ("coverage", _regions_style),
    "observed": ("crown_radius_m", _observed_style),
    "plants": ("envelope_radius_m", _plants_style),
    "trees": ("crown_radius_m", _trees_style),
    "buildings": ("building_id", _buildings_style),
    "roads": ("road_id", _roads_style),
}
"""For each layer the column without which it cannot be styled, and what makes its style."""


def _qml(
    column: str,
    categories: Sequence[Category],
    symbol: Callable[[str, str], str],
    *,
    rest: tuple[str, str],
    order_by: str | None = None,
    tip: str | None = None,
) -> str:
    """Return a categorised style in QGIS' own XML; values outside the categories get the look of `rest`.

    Parameters
    ----------
    order_by
        Column by which features are drawn, those with small values first.
    tip
        HTML of the map tip, with expressions of QGIS in it.
    """
    rows = [*(item for item in categories if not _NOT_XML.search(item[0])), ("", rest[1], rest[0])]
    listed = "\n".join(
        f'      <category render="true" symbol="{number}" type="string" value={quoteattr(value)} '
        f"label={quoteattr(label)}/>"
        for number, (value, label, _) in enumerate(rows)
    )
    symbols = "\n".join(symbol(str(number), colour) for number, (_, _, colour) in enumerate(rows))
    order = (
        f'\n    <orderby>\n      <orderByClause asc="1" nullsFirst="1">&quot;{order_by}&quot;</orderByClause>\n'
        "    </orderby>"
        if order_by
        else ""
    )
    ordered = int(order_by is not None)
    map_tip = f'\n  <mapTip enabled="1">{escape(tip)}</mapTip>' if tip else ""
    parts = "Symbology|MapTips" if tip else "Symbology"
    return f"""<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="{parts}" symbologyReferenceScale="-1">
  <renderer-v2 type="categorizedSymbol" attr="{column}" forceraster="0" symbollevels="0" enableorderby="{ordered}">
    <categories>
{listed}
    </categories>
    <symbols>
{symbols}
    </symbols>{order}
  </renderer-v2>{map_tip}
</qgis>
"""


def _rgba(colour: str, opacity: float = 1.0) -> str:
    red, green, blue = (round(255 * part) for part in to_rgb(colour))
    return f"{red},{green},{blue},{round(255 * opacity)}"


def _symbol(name: str, kind: str, layer_class: str, options: Mapping[str, str], properties: str = "") -> str:
    listed = "\n".join(
        f'            <Option type="QString" name="{key}" value="{value}"/>' for key, value in options.items()
    )
    return f"""      <symbol type="{kind}" name="{name}" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="{layer_class}" enabled="1" locked="0" pass="0">
          <Option type="Map">
{listed}
          </Option>
{_old_form(options)}
{properties}        </layer>
      </symbol>"""


def _old_form(options: Mapping[str, str]) -> str:
    """Return the same options as QGIS before 3.24 reads them."""
    return "\n".join(f'          <prop k="{key}" v="{value}"/>' for key, value in options.items())


def _fill_symbol(name: str, colour: str) -> str:
    options = {
        "color": _rgba(colour), "style": "solid", "outline_color": _rgba(mixed(colour, "#6f6a60", 0.4)),
        "outline_style": "solid", "outline_width": "0.15", "outline_width_unit": "MM", "joinstyle": "round",
    }  # fmt: skip
    return _symbol(name, "fill", "SimpleFill", options)


def _area_symbol(name: str, colour: str) -> str:
    options = {
        "color": _rgba(colour, 0.28), "style": "solid", "outline_color": _rgba(colour, 0.9), "outline_style": "dash",
        "outline_width": "0.2", "outline_width_unit": "MM", "joinstyle": "round",
    }  # fmt: skip
    return _symbol(name, "fill", "SimpleFill", options)


def _region_symbol(name: str, colour: str) -> str:
    options = {
        "color": _rgba(colour, 0.45), "style": "solid", "outline_color": _rgba(mixed(colour, "#000000", 0.3), 0.9),
        "outline_style": "solid", "outline_width": "0.2", "outline_width_unit": "MM", "joinstyle": "round",
    }  # fmt: skip
    return _symbol(name, "fill", "SimpleFill", options)


def _building_symbol(name: str, colour: str) -> str:
    options = {
        "color": _rgba(colour), "style": "solid", "outline_color": _rgba(mixed(colour, "#4a463e", 0.6)),
        "outline_style": "solid", "outline_width": "0.2", "outline_width_unit": "MM", "joinstyle": "miter",
    }  # fmt: skip
    return _symbol(name, "fill", "SimpleFill", options)


def _road_symbol(name: str, colour: str) -> str:
    options = {"color": _rgba(colour), "style": "solid", "outline_style": "no"}
    return _symbol(name, "fill", "SimpleFill", options)


def _crown_symbol(name: str, colour: str, *, radius: str) -> str:
    """A circle as wide on the ground as a column says, in metres, whatever the unit of the layer's CRS."""
    fill, outline = _rgba(colour, 0.85), _rgba(mixed(colour, "#000000", 0.4), 0.9)
    return _circle(name, fill, outline, "0.1", f"2 * &quot;{radius}&quot;")


def _ring_symbol(name: str, colour: str, *, radius: str) -> str:
    """A ring as wide on the ground as a column says, 2 m where it is empty."""
    return _circle(name, _rgba(colour, 0.0), _rgba(colour), "0.4", f"2 * coalesce(&quot;{radius}&quot;, 1)")


def _circle(name: str, fill: str, outline: str, outline_mm: str, diameter: str) -> str:
    options = {
        "name": "circle", "color": fill, "outline_color": outline,
        "outline_style": "solid", "outline_width": outline_mm, "outline_width_unit": "MM", "scale_method": "diameter",
        "size": "5", "size_unit": "RenderMetersInMapUnits", "horizontal_anchor_point": "1",
        "vertical_anchor_point": "1",
    }  # fmt: skip
    properties = """          <data_defined_properties>
            <Option type="Map">
              <Option type="QString" name="name" value=""/>
              <Option type="Map" name="properties">
                <Option type="Map" name="size">
                  <Option type="bool" name="active" value="true"/>
                  <Option type="QString" name="expression" value="@DIAMETER@"/>
                  <Option type="int" name="type" value="3"/>
                </Option>
              </Option>
              <Option type="QString" name="type" value="collection"/>
            </Option>
          </data_defined_properties>
""".replace("@DIAMETER@", diameter)
    return _symbol(name, "marker", "SimpleMarker", options, properties)
