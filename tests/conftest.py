"""Which tests run when nothing is said."""


def pytest_collection_modifyitems(config, items):
    """``boundscheck`` compiles every kernel anew, minutes of it: only with its file or ``-m boundscheck``."""
    if config.option.markexpr or any("test_bounds" in str(argument) for argument in config.args):
        return
    left_out = [item for item in items if item.get_closest_marker("boundscheck")]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]
