from wisar_planner.cli import warm_up
from wisar_planner.evaluation import run
from wisar_planner.pdm import GaussianMixture, RasterMap


def test_every_planner_plans_on_both_kinds_of_map(monkeypatch):
    planned = []
    lawnmower = run.PlannerSpec("lawnmower").make()

    class Recording:
        def __init__(self, name):
            self.name = name

        def plan(self, problem, **_):
            planned.append((self.name, type(problem.pdm)))
            return lawnmower.plan(problem)

    monkeypatch.setattr(run, "make_planner", Recording)
    monkeypatch.setattr(run, "_warm", set())
    monkeypatch.setattr(run, "_planners", {})
    monkeypatch.setattr("wisar_planner.planners.registry._HOMES", {"one": None, "two": None})
    warm_up.main()
    wanted = {(name, kind) for name in ("one", "two") for kind in (GaussianMixture, RasterMap)}
    assert set(planned) == wanted
