"""Codes on a truck's bus: an SAE J1939 node that sends DM1 and answers DM2 and DM3."""
