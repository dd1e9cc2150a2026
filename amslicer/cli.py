def main() -> int:
    from amslicer.device import list_devices

    ds = list_devices()
    print(ds)
    return 0 if any(d.works for d in ds) else 5
