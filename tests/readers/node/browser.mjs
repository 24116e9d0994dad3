// A page in headless Chromium, served on loopback; whatever asks for another host is refused and told.
import { createReadStream, statSync } from "node:fs";
import { createServer } from "node:http";
import { dirname, extname, join, normalize, sep } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";
import { chromium } from "playwright-core";

const HERE = dirname(fileURLToPath(import.meta.url));
const TYPES = {
  ".html": "text/html", ".js": "text/javascript", ".json": "application/json", ".css": "text/css",
  ".glb": "model/gltf-binary", ".wasm": "application/wasm", ".png": "image/png", ".jpg": "image/jpeg",
};
const FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"];
const VIEWPORT = { width: 640, height: 400 };
const PATIENCE_MS = 180_000;

function inside(folder, path) {
  const file = normalize(join(folder, path));
  return file.startsWith(normalize(folder) + sep) ? file : null;
}

function serve(roots, texts) {
  const server = createServer((request, response) => {
    const path = decodeURIComponent(new URL(request.url, "http://loopback").pathname);
    if (path in texts) {
      response.writeHead(200, { "content-type": TYPES[extname(path) || ".html"] });
      response.end(texts[path]);
      return;
    }
    const root = Object.keys(roots).find((name) => path.startsWith(name));
    const file = root && inside(roots[root], path.slice(root.length));
    try {
      const { size } = statSync(file);
      response.writeHead(200, { "content-type": TYPES[extname(file)] ?? "application/octet-stream", "content-length": size });
      createReadStream(file).pipe(response);
    } catch {
      response.writeHead(404);
      response.end();
    }
  });
  return new Promise((resolve) => server.listen(0, "127.0.0.1", () => resolve(server)));
}

/**
 * Run a page's script, which answers by `window.answer(value)`, and take a picture of what it shows.
 *
 * script: file beside this one, bundled; roots: folders by the path they are served under; question: what the script
 * finds as `window.question`; scripts: paths of scripts that come before it.
 */
export async function ask(script, { roots, question, picture, scripts = [] }) {
  const bundle = await build({
    entryPoints: [join(HERE, script)], bundle: true, write: false, format: "iife", target: "es2022", logLevel: "silent",
  });
  const tags = [...scripts, "/page.js"].map((path) => `<script src="${path}"></script>`).join("");
  const html = `<!doctype html><link rel="icon" href="data:,"><style>*{margin:0}canvas{display:block}</style>
<div id="view" style="width:${VIEWPORT.width}px;height:${VIEWPORT.height}px"></div>
<script>window.question = ${JSON.stringify(question)}</script>${tags}`;
  const server = await serve(roots, { "/": html, "/page.js": bundle.outputFiles[0].text });
  const origin = `http://127.0.0.1:${server.address().port}`;
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM, args: [...FLAGS, ...(process.getuid() === 0 ? ["--no-sandbox"] : [])],
  });
  const told = [];
  const elsewhere = [];
  const missing = [];
  try {
    const page = await browser.newPage({ viewport: VIEWPORT });
    await page.route("**", (route) => {
      const url = route.request().url();
      if (url.startsWith(origin) || url.startsWith("data:") || url.startsWith("blob:")) return route.continue();
      elsewhere.push(url);
      return route.abort();
    });
    page.on("response", (response) => response.status() >= 400 && missing.push(response.url()));
    const answer = new Promise((resolve, reject) => {
      page.exposeFunction("answer", resolve);
      page.on("pageerror", (error) => reject(error));
      page.on("crash", () => reject(new Error("the page crashed")));
      page.on("console", (message) => ["error", "warning"].includes(message.type()) && told.push(message.text()));
      setTimeout(() => reject(new Error(`no answer in ${PATIENCE_MS} ms; ${told.join("; ")}`)), PATIENCE_MS).unref();
    });
    await page.goto(`${origin}/`);
    const value = await answer;
    if (picture) await page.screenshot({ path: picture });
    return { ...value, requests_elsewhere: elsewhere, requests_missing: missing, told };
  } finally {
    await browser.close();
    server.closeAllConnections();
    server.close();
  }
}

/** Run what a script is for, and print its answer as JSON. */
export async function main(run) {
  try {
    process.stdout.write(JSON.stringify(await run(JSON.parse(process.argv[2]))) + "\n");
  } catch (error) {
    process.stderr.write(`${error.stack ?? error}\n`);
    process.exitCode = 1;
  }
}
