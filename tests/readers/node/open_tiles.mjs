// 3d-tiles-renderer opens a tileset and loads what it would show at an error of some pixels:
// node open_tiles.mjs '{"folder": ..., "tileset": "tiles/tileset.json", "error_px": 16, "distance": 1.2, "picture": ...}'
import { ask, main } from "./browser.mjs";

main(({ folder, picture, ...question }) =>
  ask("page_tiles.js", { roots: { "/out/": folder }, question: { ...question, drawn: Boolean(picture) }, picture }),
);
