"""Read what receivers record themselves: UBX of u-blox, and the raw measurements of Android phones."""
