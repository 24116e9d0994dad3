import { AmbientLight, Color, DirectionalLight, PerspectiveCamera, Scene, WebGLRenderer } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { placedRows, textColumn } from "./instances.js";

async function run({ file, eye, at }) {
  const view = document.getElementById("view");
  const renderer = new WebGLRenderer({ antialias: false });
  renderer.setSize(view.clientWidth, view.clientHeight);
  view.append(renderer.domElement);
  const gltf = await new GLTFLoader().loadAsync(`/out/${file}`);
  const scene = new Scene();
  scene.background = new Color(0xcfe3f5);
  const sun = new DirectionalLight(0xffffff, 3);
  sun.position.set(-1, 2, 1);
  scene.add(new AmbientLight(0xffffff, 1.5), sun, gltf.scene);
  const camera = new PerspectiveCamera(50, view.clientWidth / view.clientHeight, 1, 5000);
  camera.position.set(...eye);
  camera.lookAt(...at);
  renderer.render(scene, camera);
  const placed = placedRows(gltf.scene);
  const ids = gltf.parser.json.extensions?.EXT_structural_metadata ? await textColumn(gltf.parser, "plant_id") : null;
  const nodes = [];
  gltf.scene.traverse((object) => nodes.push(object.type));
  await window.answer({
    ...placed, ids, nodes: nodes.length, extras: gltf.asset.extras ?? null, drawn_triangles: renderer.info.render.triangles,
  });
}

run(window.question).catch((error) => setTimeout(() => { throw error; }));
