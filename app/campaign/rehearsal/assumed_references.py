"""The references that a rehearsal assumes: axes that are unreferenced after power-up."""

from goniotwin.app.rig import OpenRig


def assume_referenced(opened: OpenRig) -> list[str]:
    """Reference the axes that are unreferenced after power-up, at the twin's positions; give the assumptions."""
    unreferenced = [name for name, axis in opened.rig.axes.items() if axis.unreferenced_reason]
    for name in unreferenced:
        opened.rig.axes[name].set_position()
    return [f"{name} has been referenced before the campaign begins (goniotwin home, goniotwin here)" for name in unreferenced]
