/* global Cesium */
const PROPERTIES = ["plant_id", "lot_id", "species", "habit", "height_m"];

function settled(scene, tileset) {
  return new Promise((resolve) => {
    let quiet = 0;
    const remove = scene.postRender.addEventListener(() => {
      quiet = tileset.tilesLoaded ? quiet + 1 : 0;
      if (quiet >= 3) {
        remove();
        resolve();
      }
    });
  });
}

async function run({ tileset: path, longitude, latitude, height }) {
  Cesium.Ion.defaultAccessToken = "";
  const viewer = new Cesium.CesiumWidget("view", {
    baseLayer: false, skyBox: false, skyAtmosphere: false, globe: false, useBrowserRecommendedResolution: true,
    creditContainer: document.createElement("div"), contextOptions: { webgl: { preserveDrawingBuffer: true } }, msaaSamples: 1,
  });
  const { scene, camera } = viewer;
  viewer.container.firstChild.style.height = viewer.canvas.style.height = "100%"; // as Cesium's own style sheet has it
  viewer.canvas.style.width = "100%";
  viewer.resize();
  scene.renderError.addEventListener((_, error) => setTimeout(() => { throw error; }));
  scene.backgroundColor = Cesium.Color.fromCssColorString("#cfe3f5");
  const tileset = await Cesium.Cesium3DTileset.fromUrl(`/out/${path}`);
  const failures = [];
  tileset.tileFailed.addEventListener(({ url, message }) => failures.push(`${url}: ${message}`));
  scene.primitives.add(tileset);
  const foot = Cesium.Cartesian3.fromDegrees(longitude, latitude, 0);
  const crown = Cesium.Cartesian3.fromDegrees(longitude, latitude, 0.7 * height);
  camera.lookAt(crown, new Cesium.HeadingPitchRange(0.3, -0.9, 4 * height + 10));
  camera.lookAtTransform(Cesium.Matrix4.IDENTITY);
  await settled(scene, tileset);
  const window_ = Cesium.SceneTransforms.worldToWindowCoordinates(scene, crown);
  const picks = [];
  for (const [dx, dy] of [[0, 0], [4, 0], [-4, 0], [0, 4], [0, -4], [8, 6], [-8, 6]]) {
    const picked = scene.pick(new Cesium.Cartesian2(window_.x + dx, window_.y + dy));
    if (picked?.getProperty) picks.push(Object.fromEntries(PROPERTIES.map((name) => [name, picked.getProperty(name)])));
  }
  // Buildings and ground have no height_m: Cesium evaluates a style for them too, and Number() keeps it from stumbling.
  const color = `Number(\${height_m}) > ${height - 0.5} ? color('orange') : color('white')`;
  tileset.style = new Cesium.Cesium3DTileStyle({ color });
  await settled(scene, tileset);
  scene.render();
  const { numberOfTilesWithContentReady, numberOfFeaturesLoaded } = tileset.statistics;
  await window.answer({
    picks, failures, version: Cesium.VERSION, tiles: numberOfTilesWithContentReady, features: numberOfFeaturesLoaded,
    distance: Cesium.Cartesian3.distance(foot, tileset.boundingSphere.center), radius: tileset.boundingSphere.radius,
  });
}

run(window.question).catch((error) => setTimeout(() => { throw error; }));
