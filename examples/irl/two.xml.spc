<?xml version="1.0"?>
<!-- The specification of two.spc as XML. -->
<system>
  <robot name="tx90" model="staubli_tx90">
    <tool z="100"/>
    <home positions="0 0 90 0 60 0"/>
    <joint min="-180" max="180" speed="400" acceleration="1200" jerk="12000"/>
    <joint min="-130" max="147.5" speed="400" acceleration="1200" jerk="12000"/>
    <joint min="-145" max="145" speed="430" acceleration="1200" jerk="12000"/>
    <joint min="-270" max="270" speed="540" acceleration="1600" jerk="16000"/>
    <joint min="-115" max="140" speed="475" acceleration="1600" jerk="16000"/>
    <joint min="-270" max="270" speed="760" acceleration="2000" jerk="20000"/>
  </robot>
  <robot name="lwr" model="kuka_lwr4">
    <base x="1500" a="180"/>
    <home positions="0 30 0 -60 0 60 0"/>
    <joint min="-170" max="170" speed="110" acceleration="400" jerk="4000"/>
    <joint min="-120" max="120" speed="110" acceleration="400" jerk="4000"/>
    <joint min="-170" max="170" speed="128" acceleration="400" jerk="4000"/>
    <joint min="-120" max="120" speed="128" acceleration="400" jerk="4000"/>
    <joint min="-170" max="170" speed="204" acceleration="600" jerk="6000"/>
    <joint min="-120" max="120" speed="184" acceleration="600" jerk="6000"/>
    <joint min="-170" max="170" speed="184" acceleration="600" jerk="6000"/>
  </robot>
  <signal name="part_present" direction="in" kind="digital" channel="0"/>
  <signal name="pressure" direction="in" kind="analog" channel="0"/>
  <signal name="grip" direction="out" kind="digital" channel="0"/>
  <signal name="count" direction="out" kind="binary" channel="0" bits="8" io="io:0"/>
</system>
