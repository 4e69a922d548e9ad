"""The subcommands of ``probe-env``: one dataclass each, tyro makes the options from them."""
