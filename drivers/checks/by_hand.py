"""Assumed facts that no command can verify: what a person does and must see, and the facts on which no driver relies."""

BY_HAND: dict[str, tuple[tuple[str, str, str], ...]] = {
    "axes": (
        ("A part of a frame is forgotten", "Run `goniotwin devices` twice.", "Both lists name the controller."),
        (
            "User variables 56 to 255",
            "Switch the controller off and on. Run `goniotwin move` for an axis without `power_up_at_reference`.",
            "The move is refused, because the axis is unreferenced.",
        ),
        (
            "209 is zero after a power-up",
            "Move an axis with an encoder off zero. Switch the controller off and on. Run `goniotwin verify-device`.",
            "Its check of the encoder says *lost in a reset*. TMCL-IDE shows parameter 209 near zero.",
        ),
        (
            "73 = 1234 locks",
            "Nothing to do where `verify-device` connects. Where it reports a locked module, set parameter 73 to 4321.",
            "The module then accepts its heartbeat.",
        ),
        (
            "68 is kept in EEPROM",
            "Read global parameter 68 with the maker's TMCL-IDE before and after a command of goniotwin.",
            "Both values are equal.",
        ),
        (
            "193: the direction",
            "Run `goniotwin home` with a hand on the main switch.",
            "The axis turns towards its reference switch.",
        ),
        (
            "Where exactly zero is",
            "Home the axis three times, and read its scale each time.",
            "The scale shows `angle_deg` of the [homing] table, each time within the tolerance.",
        ),
        (
            "A motor that a switch has stopped",
            "Press a limit switch by hand during a slow `goniotwin move`. Release it.",
            "The axis stops, does not go on, and the command names the switch.",
        ),
        (
            "181 stops the motor",
            "Only with the maker's advice: hold a weak axis during a slow move.",
            "The motor stops, and the command names the stall.",
        ),
    ),
    "monochromator": (
        (
            "CR LF, `ABORT`, `SHUTTER C`",
            "Start `goniotwin run`. When the shutter is open, kill the process (`kill -9`).",
            "The shutter closes within seconds.",
        ),
        (
            "Handshake mode and units are off",
            "Switch the unit off and on during a row of a run.",
            "The run reports that the monochromator has lost its settings.",
        ),
    ),
    "photodiodes": (
        (
            "Ranges, enabled channels and outputs",
            "Switch a module off and on during a row of a run, at a gain other than the lowest.",
            "The run reports that the photodiodes have lost their settings.",
        ),
        (
            "10 or 100 conversions",
            "Compare `conversions_per_s` with the setting of the module in the maker's utility.",
            "Both are equal.",
        ),
    ),
    "monitor": (
        (
            "Its responsivity",
            "Compare a power reading of the instrument's display with its certificate.",
            "The power agrees. A campaign uses the current alone.",
        ),
    ),
}
"""By role: the first words of the fact's row in docs/rig/interoperability.md, what to do, and what must be seen."""

NOT_NEEDED: tuple[str, ...] = (
    # Cornerstone 260
    "Error 7",
    "`CALIBRATE` changes",
    "Units of offset and zero",
    "`ADDRESS?`",
    "`SLITnMICRONS`",
    "`UNITS?` answers in capitals",
    "`HANDSHAKE 0` has no status",
    # TMCL
    "127 = 2 refers",
    "65, codes of the baud rates",
    "A new address",
    "Modules that have one address",
    # ADAM
    "40212 is 0",
    "A wrong code is refused",
    "A change of the range",
    "A disabled channel reads 0",
    "4 to 20 mA",
    "The codes of the 6000 series",
    "40215 and 40216",
    "Any other unit is silent",
    "40009 average",
    "Coils 100 and 110",
    "It takes eight connections",
    # PM100D and its bus
    "The other numbers of errors",
    "A measurement is a query",
    "Only the manual's words",
    "Years 2000 to 2099",
    "`DISP:BRIG`",
    "Status bits",
    "A range that is set",
    "`FETC?` without",
    "Their limits",
    "It takes 0.5 s",
    "`SENS:PEAK",
    "`MEAS:VOLT?`",
    "A zero takes 1 s",
    "Full speed, packets",
    "A message that comes before",
    "An answer that is not ready",
    "USB/IP 1.1.1",
    # pseudo-terminals
    "It has no modem lines",
    "What a client does not read",
)
"""Facts of the twin on which no campaign relies, or where the driver accepts either; by the first words of their rows."""
