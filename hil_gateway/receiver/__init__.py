"""GNSS and INS receivers over TCP, serial line or file: NovAtel OEM7 binary logs and NMEA."""
