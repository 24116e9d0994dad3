// three.js opens a GLB: node open_glb.mjs '{"folder": ..., "file": "forest.glb", "picture": ..., "eye": [x, y, z], "at": [x, y, z]}'
import { ask, main } from "./browser.mjs";

main(({ folder, picture, ...question }) => ask("page_glb.js", { roots: { "/out/": folder }, question, picture }));
