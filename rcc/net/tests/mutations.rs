//! Random mutations of net and value texts, fed to the same functions that a fuzzer calls: no text
//! makes loading panic, and accepted nets run. The seed is fixed.

#![allow(clippy::unwrap_used, reason = "this file is a test")]

use std::path::Path;
use std::time::Duration;

use takt_net::fuzz::{net_text, value_text};
use takt_net::{Limits, LoadContext, NoDevices, Registry, load};
use takt_tests::Random;

const ROUNDS: usize = 10_000;

/// Valid nets, so that mutations pass the first checks.
const NETS: &[&str] = &[
    "{c=Cancel(),outTerminate=c.outCancel}",
    "{a=Core::DoubleAdd(inFirst=Core::Clock(Increment='2').outValue,inSecond[2.0]=b.outValue),\
     b=Core::DoublePre(inValue=a.outValue),o=Core::DoubleNetcommOut(inValue=a.outValue,Key='v'),\
     g=Core::DoubleGreater(inFirst=a.outValue,Second='1.5'),outTerminate=g.outValue}",
    "{f={x=Core::Clock(inActive=parent.inOn),y={z=Core::DoubleSin(inValue=parent.inZ),\
     outZ=z.outValue}(inZ=x.outValue,inActive=parent.inOn),outX=y.outZ}(inOn=on.outValue),\
     on=Core::BooleanNetcommIn(Key='on',Value='true'),n=Core::DoubleIsNull(inValue=f.outX),\
     outTerminate=n.outValue}",
    "{a=World::FrameArray(Size='3'),s=World::FrameArraySet(inArray=a.outArray,Size='3',Index='1',\
     inValue=f.outValue),f=World::FrameFromPosRot(X='1',A='0.5'),\
     g=World::FrameArrayGet(inArray=s.outArray,Size='3',Index='1'),\
     t=World::FrameAtTime(inValue=g.outValue,Age='0.002',MaxAge='0.01'),\
     n=World::FrameIsNull(inValue=t.outValue),outTerminate=n.outValue}",
];

const VALUES: &[&str] = &[
    "true",
    "-42",
    "0.5",
    "1e-300",
    "nan",
    "+inf",
    "[1,2.5,-3]",
    "[true,false]",
    "{x:1,y:-2.5,z:0}",
    "{a:0.1,b:0,c:3}",
    "{pos:{x:1},rot:{a:0.5}}",
    "{vel:{x:1},rot:{z:2}}",
    "{force:{y:1},torque:{}}",
    "[{x:1},{y:2}]",
    "9223372036854775807",
];

/// Words with a meaning somewhere.
const WORDS: &[&str] = &[
    "{",
    "}",
    "(",
    ")",
    "[",
    "]",
    ",",
    "=",
    ".",
    "'",
    "\\",
    "\\'",
    "parent",
    "outTerminate",
    "inActive",
    "outValue",
    "Value='",
    "Size='99'",
    "Size='-1'",
    "Core::Clock()",
    "ä",
    "\u{0}",
    "\n",
    "#",
    "{}()",
    "nan",
    "1e999",
    ":",
];

fn pick<'a, T>(random: &mut Random, of: &'a [T]) -> &'a T {
    &of[random.below(of.len())]
}

fn random_range(random: &mut Random, len: usize) -> std::ops::Range<usize> {
    let start = random.below(len + 1);
    start..(start + random.below(24)).min(len)
}

/// Changes `text` at one location.
fn mutate(random: &mut Random, text: &mut Vec<u8>, others: &[Vec<u8>]) {
    let range = random_range(random, text.len());
    let new = match random.below(5) {
        0 => Vec::new(),
        1 => pick(random, WORDS).as_bytes().to_vec(),
        2 => {
            let bits = 1 << random.below(8);
            text[range.clone()].iter().map(|b| b ^ bits).collect()
        }
        3 => text[range.clone()].repeat(2),
        _ => {
            let other = pick(random, others);
            other[random_range(random, other.len())].to_vec()
        }
    };
    text.splice(range, new);
}

fn mutated(random: &mut Random, texts: &[Vec<u8>]) -> Vec<u8> {
    let mut text = pick(random, texts).clone();
    for _ in 0..=random.below(4) {
        mutate(random, &mut text, texts);
    }
    text
}

fn bytes(texts: &[&str]) -> Vec<Vec<u8>> {
    texts.iter().map(|t| t.as_bytes().to_vec()).collect()
}

#[test]
fn no_net_text_makes_loading_panic() {
    let mut nets = bytes(NETS);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults");
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|f| f.unwrap().path())
        .collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "net"));
    files.sort();
    nets.extend(files.iter().map(|f| std::fs::read(f).unwrap()));
    nets.iter().for_each(|net| net_text(net));
    let mut random = Random::new(0x9e37_79b9_7f4a_7c15);
    for _ in 0..ROUNDS {
        net_text(&mutated(&mut random, &nets));
    }
}

#[test]
fn no_value_text_makes_reading_panic() {
    let values = bytes(VALUES);
    let mut random = Random::new(0x2545_f491_4f6c_dd1d);
    for round in 0..ROUNDS {
        let mut text = mutated(&mut random, &values);
        text.insert(0, u8::try_from(round % 251).unwrap());
        value_text(&text);
    }
}

#[test]
fn repeated_faults_are_bounded() {
    let empty: String = (0..200_000).map(|i| format!("c{i}={{}},")).collect();
    let loops = "a=f.x,".repeat(200_000);
    let fragments = format!("{{f={{x=parent.i}}(i=f.x),{empty}{loops}d=f.x}}");
    let ports: String = (0..50_000).map(|i| format!("p{i}=x.y,")).collect();
    let links = "a=f.q,".repeat(100);
    let names = format!("{{f={{{ports}z=x.y}},{links}b=f.q}}");
    let args = "Value='1',".repeat(200_000);
    let twice = format!("{{a=Core::DoubleValue({args}Value='1')}}");
    for text in [fragments, names, twice] {
        let registry = Registry::core();
        let context = LoadContext {
            registry: &registry,
            devices: &NoDevices,
            period: Duration::from_millis(1),
            limits: Limits {
                text_bytes: 8 << 20,
                ..Limits::default()
            },
        };
        let rejection = load(&text, &context).unwrap_err();
        assert!(rejection.faults.len() <= 101, "{}", rejection.faults.len());
        let kept = format!("{rejection:?}").len();
        assert!(kept < 1 << 20, "{kept} bytes");
    }
}

#[test]
fn inline_names_stay_short() {
    let long = "N".repeat(30_000);
    let inner = "b=C().d,".repeat(300);
    let text = format!("{{{long}=P({inner}c=C().d)}}");
    let xml = takt_net::xml::to_xml(&text, &Limits::default()).unwrap();
    // The long name itself occurs once.
    assert!(xml.len() < 200_000, "{} bytes", xml.len());
}

#[test]
fn largest_texts_are_loaded() {
    let open = "f={".repeat(20_000);
    let commas = format!("{{{}", ",".repeat(60_000));
    let many = format!("{{{}", "a=Cancel(),".repeat(5900));
    let chain: String = (0..900)
        .map(|i| format!("a{i}=Core::DoubleSin(inValue=a{}.outValue),", i + 1))
        .collect();
    let chain = format!("{{{chain}a900=Core::Clock(),c=Cancel(),outTerminate=c.outCancel}}");
    let unknown = format!("{{{}", "a=Nope(),".repeat(7000));
    let long = format!("{{a={}()}}", "N".repeat(60_000));
    for text in [open, commas, many, chain, unknown, long] {
        net_text(text.as_bytes());
    }
}
