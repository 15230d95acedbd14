import sys
sys.path[:0]=['tests/viewer','tests/helpers','tests']
import test_viewer_engine as t, collections
from gffe_cl.engine.opencl.device import Device
from gffe_cl.viewer.engine.engine import open_viewer_device
import re
def test_scan(device):
    for scene in ("barred",):
        with t.running(device, t.SceneClip(scene)) as e:
            for slot in (9,13,15,):
                try: st=t.stories(e,t.Setup(t.Options(levels=0)),slot,lambda i:i["frame.filled_by"]==255,400)
                except AssertionError: continue
                c=collections.Counter()
                for s in st:
                    for m in s.sentences:
                        if "Hidden parts of" in m: c[re.sub(r"[-\d.]+","N",m)]+=1; 
                        if "But" in m: print(m)
                print(scene,slot,c)
