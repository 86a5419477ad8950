import pytest

torch = pytest.importorskip("torch")


@pytest.fixture(autouse=True, scope="session")
def one_thread() -> None:
    """Small arrays gain nothing from threads, and the tests share the cores."""
    torch.set_num_threads(1)
