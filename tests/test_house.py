"""The floor plan: imports go one way, and heavy packages stay near their use."""

import ast
from pathlib import Path

import urbanforest_cli

PACKAGE = Path(urbanforest_cli.__file__).parent
FOUNDATIONS = {"core", "files"}
TOP = {
    "main", "commands", "pipeline", "pipeline_alone", "pipeline_figures", "pipeline_growth_figures",
    "pipeline_folder", "pipeline_image", "pipeline_pairs", "pipeline_sheet", "pipeline_study", "pipeline_towns",
    "__main__",
}  # fmt: skip


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


def modules():
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).parts
        yield path, parts[0].removesuffix(".py"), path.stem


def own(names: set[str]) -> set[str]:
    return {name.split(".")[1] for name in names if name.startswith("urbanforest_cli.")}


def test_stages_meet_in_files_and_core_alone():
    for path, room, stem in modules():
        rooms = own(imports(path))
        if room in TOP or room == "__init__":
            continue
        allowed = {"core"} | ({room} if room != "core" else set())
        if stem == "stage" or room == "files" or stem == "core":
            allowed |= FOUNDATIONS
        if room not in FOUNDATIONS and stem != "stage":
            assert "files" not in rooms, f"{path} opens files below its stage"
        assert rooms <= allowed | ({"files"} if stem == "stage" else set()), f"{path} imports {rooms - allowed}"


def test_click_is_spoken_in_commands_alone():
    for path, room, _ in modules():
        if room not in {"commands", "main"}:
            assert "click" not in {name.split(".")[0] for name in imports(path)}, path


def test_torch_stays_in_training():
    for path, _, stem in modules():
        if "torch" in {name.split(".")[0] for name in imports(path)}:
            assert stem in {"training", "network"}, path
