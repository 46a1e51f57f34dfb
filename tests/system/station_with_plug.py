"""`goniotwin station` of a virtual rig whose monitor has a plug, and whose beta can be held.

SIGUSR1 pulls the plug, SIGUSR2 puts it in again. SIGRTMIN holds beta where it is, SIGRTMIN + 1 lets it go.
"""

import signal

from goniotwin.app.cli.main import main
from goniotwin.app.rig import OpenRig, RigDescription
from goniotwin.app.station.station import Station

adopt = Station.adopt


def adopt_with_plug(self: Station, opened: OpenRig, description: RigDescription) -> None:
    """Let signals pull and put the plug from the opening of the rig on."""
    adopt(self, opened, description)
    virtual = opened.virtual
    assert virtual is not None

    def pull(_number: int, _frame: object) -> None:
        with virtual.lock:
            virtual.usb["monitor"].unplug()

    def put(_number: int, _frame: object) -> None:
        with virtual.lock:
            virtual.usb["monitor"].replug()

    def hold(number: int, _frame: object) -> None:
        with virtual.lock:
            virtual.plant.shafts["beta"].jam(opened.rig.clock.now(), number == signal.SIGRTMIN)

    signal.signal(signal.SIGRTMIN, hold)
    signal.signal(signal.SIGRTMIN + 1, hold)
    signal.signal(signal.SIGUSR1, pull)
    signal.signal(signal.SIGUSR2, put)


if __name__ == "__main__":
    Station.adopt = adopt_with_plug  # type: ignore[method-assign]
    main()
