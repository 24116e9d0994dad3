// Khronos' validator over glTF files: node validate.mjs '{"files": [...]}'
import { readFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { validateBytes } from "gltf-validator";
import { main } from "./browser.mjs";

async function validate(file) {
  const report = await validateBytes(new Uint8Array(await readFile(file)), {
    uri: file,
    maxIssues: 0,
    externalResourceFunction: async (uri) => new Uint8Array(await readFile(join(dirname(file), decodeURIComponent(uri)))),
  });
  const kinds = ["errors", "warnings", "infos", "hints"];
  const worst = report.issues.messages.filter((message) => message.severity < 2).slice(0, 5);
  const codes = {};
  for (const message of report.issues.messages) codes[message.code] = (codes[message.code] ?? 0) + 1;
  return {
    counts: [report.issues.numErrors, report.issues.numWarnings, report.issues.numInfos, report.issues.numHints],
    kinds, codes, worst, triangles: report.info?.totalTriangleCount ?? 0,
  };
}

main(async ({ files }) => Object.fromEntries(await Promise.all(files.map(async (file) => [file, await validate(file)]))));
