"""What a manifest stores of the command."""

from probe_agents.records.manifest import origin


def test_a_password_in_an_address_is_not_stored():
    command = "probe-env evaluate pi --backend ray --address ray://me:se@cret@host:6379 --limit 2"
    assert origin(command)["command"] == command.replace("se@cret", "***")
    assert origin("probe-env evaluate pi")["command"] == "probe-env evaluate pi"
