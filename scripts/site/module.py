"""The module of the page's physics, compiled in a process of its own by ``build.py``."""

from __future__ import annotations

from numba import typeof, types

from jackbox_env.exact.workspace import new_workspaces
from jackbox_env.model.tasks import TASKS
from scripts.site import entries
from scripts.site.webassembly import Export, compile_for_webassembly, module_of


def physics() -> bytes:
    """The module of the functions in ``entries.py``, compiled for WebAssembly; ``score`` once for each task.

    Afterwards nothing that numba compiles in this process can be called.
    """
    compile_for_webassembly()
    integer, scratch = types.int64, typeof(new_workspaces()).dtype  # type: ignore[no-untyped-call]
    numbers, floats, words, counts, workspace = map(
        types.CPointer, (types.float64, types.float32, types.uint64, types.int64, scratch)
    )
    exports = {
        "step": Export(entries.step, (numbers, workspace), entries.AT_ONCE),
        "start": Export(entries.start, (numbers, counts, words)),
        "derive": Export(entries.derive, (numbers,)),
        "measure": Export(entries.measure, (numbers,)),
        "observe": Export(entries.observe, (numbers, floats), entries.LANDING),
        "act": Export(entries.act, (numbers, floats, floats, numbers, integer, integer, integer, integer)),
    }
    for name, task in TASKS.items():
        exports[f"score_{name}"] = Export(entries.score, (numbers,), {"task_terms": task.values})
    return module_of(exports)
