"""The grey-box chain: charge, fuel, mixture, transport, mixing, sensor."""
