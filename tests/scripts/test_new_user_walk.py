"""From files of a logger of one's own to a report: what a user has to type."""


def test_three_commands_and_no_stumble(script, tmp_path, capsys):
    walk = script("new_user_walk")
    cost = walk.walk(walk.simulated(tmp_path))
    said = capsys.readouterr().out
    assert cost["commands"] == 3 <= walk.MOST
    assert cost["horizontal_rms_m"] < 1.0
    assert "axes RFU" in said
    assert "Traceback" not in said
