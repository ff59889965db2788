"""ATI's Net F/T and Ethernet Axia sensors: protocol, configuration page, line and sensor."""
