"""Tables for an ECU from recordings: lambda delay and lag, wall film, injectors, with bounds."""
