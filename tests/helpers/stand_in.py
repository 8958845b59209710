"""Speaks the worker's protocol without Blender: an image is a constant that tells its index.

settings["recipe"] says what goes wrong, in words: "crash=3" dies at sample 3, "leave=3" after it, "fault=2" cannot render it,
"slow=0.2" takes that many seconds a sample, "trace=PATH" appends each index that it renders to a file, "starts=PATH" starts
twice only (PATH counts).
"""

import json
import os
import signal
import sys
import time

import numpy as np

from mesoshell.io.image import write_exr


def main() -> None:
    settings = json.loads(sys.argv[1])
    words = dict(word.split("=", 1) for word in settings["recipe"].split() if "=" in word)
    if "unknown" in settings["recipe"]:
        print(json.dumps({"unusable": "no recipe named unknown; there are: grass"}), flush=True)
        sys.exit(2)
    if "starts" in words:
        with open(words["starts"], "a+") as starts:
            starts.write("x")
            starts.seek(0)
            if len(starts.read()) > 2:
                sys.exit("no more")
    size = settings["size"]
    shared = {"schema": 1, "alpha": "premultiplied", "recipe": settings["recipe"], "version": 1, "field_of_view": 0.4}
    shared |= {"parameters": {}, "radius_range": [1.0, 2.0], "size": [size, size], "seed": settings["seed"]}
    print(json.dumps({"manifest": shared | {"samples_per_pixel": 1}}), flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        index = request["index"]
        if request["file"] is not None:
            if str(index) == words.get("crash"):
                print("Fatal: out of luck", file=sys.stderr, flush=True)
                os.kill(os.getpid(), signal.SIGSEGV)
            if str(index) == words.get("fault"):
                print(json.dumps({"index": index, "fault": "no luck"}), flush=True)
                continue
            if "trace" in words:
                with open(words["trace"], "a") as trace:
                    trace.write(f"{index}\n")
            time.sleep(float(words.get("slow", 0)))
            write_exr(request["file"], np.full((size, size, 4), (index + 1) / 64, np.float32))
        row = {"seed": index, "size": [size, size], "parameters": {}, "camera_to_world": np.eye(4).tolist()}
        row |= {"fov": 0.4, "radius": 1.5, "light": [0.0, 0.0, 1.0], "irradiance": [1.0] * 3}
        seconds = {"geometry": 0.0, "blender": 0.0}
        print(json.dumps({"index": index, "row": row, "seconds": seconds, "memory": 1.0}), flush=True)
        if str(index) == words.get("leave"):
            sys.exit("had enough")


if __name__ == "__main__":
    main()
