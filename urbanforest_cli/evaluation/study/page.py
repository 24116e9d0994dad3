"""The questionnaire: one HTML file that needs no network and no server."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from html import escape

from urbanforest_cli.evaluation.study.trials import Design

QUESTION = "Which plant distribution looks more realistic?"
ANSWERS_FORMAT = "urbanforest-study-answers"

_STYLE = """
:root { color-scheme: light; font: 17px/1.5 system-ui, sans-serif; color: #2d2a26; background: #f6f3ec; }
body { margin: 0 auto; max-width: 62rem; padding: 1.5rem; }
h1 { font-size: 1.4rem; margin: 0 0 .6rem; }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: 1.2rem; margin: 1rem 0; }
.pair button { padding: 0; border: 4px solid transparent; border-radius: 8px; background: none; cursor: pointer; }
.pair button:hover, .pair button:focus-visible { border-color: #4f7a4d; outline: none; }
.pair img { display: block; width: 100%; border-radius: 4px; }
progress { width: 100%; accent-color: #4f7a4d; }
input, .plain { font: inherit; padding: .5rem 1rem; border: 1px solid #b7b0a2; border-radius: 6px; background: #fff; }
.plain { cursor: pointer; }
.soft { color: #6b655b; font-size: .9rem; }
textarea { width: 100%; height: 8rem; font: 12px/1.3 monospace; }
[hidden] { display: none !important; }
"""

_SCRIPT = """
"use strict";
const study = JSON.parse(document.getElementById("study").textContent);
const pictures = JSON.parse(document.getElementById("pictures").textContent);
const byId = name => document.getElementById(name);
const place = "urbanforest-study-" + study.study_id;
let state = null, shownAt = 0;

function shuffled(items, random) {
  const list = items.slice();
  for (let i = list.length - 1; i > 0; i--) {
    const j = Math.floor(random() * (i + 1));
    [list[i], list[j]] = [list[j], list[i]];
  }
  return list;
}
function keep() { try { localStorage.setItem(place, JSON.stringify(state)); } catch (e) { /* private window */ } }
function recall() { try { return JSON.parse(localStorage.getItem(place)); } catch (e) { return null; } }
function show(name) { for (const part of ["start", "ask", "end"]) byId(part).hidden = part !== name; }

function begin() {
  const trials = shuffled(study.trials, Math.random).map(
    t => Math.random() < 0.5 ? [t[0], t[1], t[2]] : [t[0], t[2], t[1]]);
  const bytes = new Uint8Array(8);
  crypto.getRandomValues(bytes);
  const drawn = Array.from(bytes, b => b.toString(16).padStart(2, "0")).join("");
  state = { format: study.format, study_id: study.study_id, rater: byId("rater").value.trim() || drawn,
            run: drawn, started_at: new Date().toISOString(), trials: trials, answers: [] };
  keep();
  ask();
}
function ask() {
  const at = state.answers.length;
  if (at >= state.trials.length) { finish(); return; }
  show("ask");
  const [id, left, right] = state.trials[at];
  byId("left").firstElementChild.src = pictures[left];
  byId("right").firstElementChild.src = pictures[right];
  byId("bar").max = state.trials.length;
  byId("bar").value = at;
  byId("count").textContent = (at + 1) + " of " + state.trials.length;
  byId("back").hidden = at === 0;
  shownAt = performance.now();
}
function answer(side) {
  const [id, left, right] = state.trials[state.answers.length];
  state.answers.push({ trial_id: id, left: left, right: right, choice: side,
                       milliseconds: Math.round(performance.now() - shownAt) });
  keep();
  ask();
}
function result() {
  const { trials, ...rest } = state;
  return JSON.stringify({ ...rest, finished: state.answers.length === trials.length }, null, 1);
}
function finish() { show("end"); byId("text").value = result(); }
function save() {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([result()], { type: "application/json" }));
  link.download = "answers-" + study.study_id + "-" + state.run + ".json";
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
byId("go").addEventListener("click", begin);
byId("left").addEventListener("click", () => answer("left"));
byId("right").addEventListener("click", () => answer("right"));
byId("back").addEventListener("click", () => { state.answers.pop(); keep(); ask(); });
for (const name of ["save", "save-early"]) byId(name).addEventListener("click", save);
byId("again").addEventListener("click", () => { try { localStorage.removeItem(place); } catch (e) { /* none */ }
                                                 state = null; show("start"); });
document.addEventListener("keydown", event => {
  if (byId("ask").hidden || event.repeat) return;
  if (event.key === "ArrowLeft") answer("left");
  if (event.key === "ArrowRight") answer("right");
});
state = recall();
if (state && state.study_id === study.study_id && Array.isArray(state.answers)) ask();
else { state = null; show("start"); }
"""


def render_questionnaire(design: Design, pictures: Mapping[str, bytes], title: str) -> str:
    """Return the page: pairs in an order and on sides that are drawn for every rater, and answers to be saved.

    It holds every picture under a name that tells nothing; which one is real stands in the key alone.

    Parameters
    ----------
    pictures
        PNG by picture name.
    """
    trials = [[trial.trial_id, *sorted((trial.real, trial.other))] for trial in design.trials]
    study = {"format": ANSWERS_FORMAT, "study_id": design.study_id, "trials": trials}
    shown = {
        picture.name: "data:image/png;base64," + base64.b64encode(pictures[picture.name]).decode("ascii")
        for picture in design.pictures
    }
    count = len(design.trials)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{_STYLE}</style>
</head>
<body>
<section id="start">
<h1>{escape(title)}</h1>
<p>You will see {count} pairs of lots from above. In each pair buildings and ground are the same, the plants are not.
Choose the picture whose plants look more like those of a real place. There is no right answer to find out; the first
look is the best. Click a picture, or press the left or right arrow key.</p>
<p>Answers stay in this browser until you save them at the end; a page that was closed goes on where it was.</p>
<p><label>Your name or code (may stay empty) <input id="rater" maxlength="60" autocomplete="off"></label>
<button id="go" class="plain">Begin</button></p>
</section>
<section id="ask" hidden>
<h1>{escape(QUESTION)}</h1>
<div class="pair">
<button id="left"><img alt="left"></button>
<button id="right"><img alt="right"></button>
</div>
<progress id="bar"></progress>
<p class="soft"><span id="count"></span> &nbsp; <button id="back" class="plain">Back</button>
<button id="save-early" class="plain">Save what there is</button></p>
</section>
<section id="end" hidden>
<h1>Done, thank you.</h1>
<p><button id="save" class="plain">Save answers</button> and send the file to whoever asked you.
If saving does not work, copy the text below.</p>
<textarea id="text" readonly></textarea>
<p><button id="again" class="plain">Another person</button></p>
</section>
<script type="application/json" id="study">{_in_script(study)}</script>
<script type="application/json" id="pictures">{_in_script(shown)}</script>
<script>{_SCRIPT}</script>
</body>
</html>
"""


def _in_script(value: object) -> str:
    return json.dumps(value, ensure_ascii=True).replace("<", "\\u003c")
