import { ImplicitTilingPlugin } from "3d-tiles-renderer/core/plugins";
import { TilesRenderer } from "3d-tiles-renderer/three";
import { Color, DirectionalLight, HemisphereLight, Matrix4, PerspectiveCamera, Scene, Sphere, Vector3, WebGLRenderer } from "three";
import { placedRows, textColumn } from "./instances.js";

const STEP_MS = 30;

async function run({ tileset, error_px, distance, drawn }) {
  const view = document.getElementById("view");
  const renderer = new WebGLRenderer({ antialias: false });
  renderer.setSize(view.clientWidth, view.clientHeight);
  view.append(renderer.domElement);
  const scene = new Scene();
  scene.background = new Color(0xcfe3f5);
  const camera = new PerspectiveCamera(50, view.clientWidth / view.clientHeight, 1, 20000);
  const tiles = new TilesRenderer(`/out/${tileset}`);
  tiles.registerPlugin(new ImplicitTilingPlugin());
  tiles.errorTarget = error_px;
  tiles.maxTilesProcessed = 10_000;
  tiles.lruCache.maxBytesSize = Infinity;
  tiles.lruCache.minBytesSize = Infinity;
  tiles.lruCache.maxSize = tiles.lruCache.minSize = 100_000;
  const failures = [];
  tiles.addEventListener("load-error", ({ error, url }) => failures.push(`${url}: ${error}`));
  let loaded = 0;
  tiles.addEventListener("load-model", () => (loaded += 1));
  tiles.setCamera(camera);
  tiles.setResolutionFromRenderer(camera, renderer);
  scene.add(tiles.group, new HemisphereLight(0xffffff, 0x99aa88, 3));

  await new Promise((resolve) => {
    tiles.addEventListener("load-root-tileset", resolve);
    tiles.update();
  });
  const sphere = new Sphere();
  tiles.getBoundingSphere(sphere);
  const up = sphere.center.clone().normalize();
  const east = new Vector3(0, 0, 1).cross(up).normalize();
  const north = up.clone().cross(east);
  // To the frame of east, north and up about the middle, so that what is drawn keeps its float32 digits.
  const home = new Matrix4().makeBasis(east, north, up).setPosition(sphere.center).invert();
  tiles.group.matrixAutoUpdate = false;
  tiles.group.matrix.copy(home);
  tiles.group.updateMatrixWorld(true);
  camera.up.set(0, 0, 1);
  camera.position.set(0, -distance * sphere.radius, 0.7 * distance * sphere.radius);
  camera.lookAt(0, 0, 0);
  camera.updateMatrixWorld(true);

  for (let quiet = 0; quiet < 20; ) {
    tiles.update();
    await new Promise((resolve) => setTimeout(resolve, STEP_MS));
    quiet = tiles.loadProgress === 1 ? quiet + 1 : 0;
  }
  if (drawn) renderer.render(scene, camera);
  const shown = [...tiles.visibleTiles].map((tile) => tile.engineData).filter(({ scene: model }) => model);
  const plants = [];
  let meshes = 0;
  for (const { scene: model, metadata } of shown) {
    const placed = placedRows(model);
    meshes += placed.meshes;
    if (placed.rows.length === 0) continue;
    const ids = await textColumn(metadata.parser, "plant_id");
    const toEarth = model.matrixWorld.clone().premultiply(home.clone().invert());
    for (const [row, ...place] of placed.rows) {
      plants.push([ids[row], ...new Vector3(...place).applyMatrix4(toEarth).toArray()]);
    }
  }
  await window.answer({ plants, meshes, shown: shown.length, loaded, failures });
}

run(window.question).catch((error) => setTimeout(() => { throw error; }));
