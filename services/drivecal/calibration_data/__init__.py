"""Calibration data of other tools: chosen values out as DCM, CDFX and CSV, parameters in from A2L, DCM and CDFX. Pure: text in, text out.

    from drivecal.calibration_data import cdfx, dcm

    values = dcm.read(Path("acc.dcm").read_bytes(), "acc.dcm").characteristics
    Path("acc.cdfx").write_bytes(cdfx.write(values))

Values, curves, maps and arrays have a counterpart among drivecal's parameters; the names of others are listed as `skipped`.
"""
