"""The arc's photodiodes behind Advantech converter modules, on Modbus."""
