// CesiumJS opens a tileset and picks a plant:
// node open_tiles_cesium.mjs '{"folder": ..., "tileset": "tiles/tileset.json", "longitude": ..., "latitude": ..., "height": ..., "picture": ...}'
import { fileURLToPath } from "node:url";
import { ask, main } from "./browser.mjs";

const CESIUM = fileURLToPath(new URL("node_modules/cesium/Build/Cesium", import.meta.url));

main(({ folder, picture, ...question }) =>
  ask("page_cesium.js", {
    roots: { "/out/": folder, "/cesium/": CESIUM }, scripts: ["/cesium/Cesium.js"], question, picture,
  }),
);
