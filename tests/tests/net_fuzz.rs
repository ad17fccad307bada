//! Every format that comes from outside, fed with seeded random bytes: what `cargo fuzz` does for
//! hours, for a moment in every run. The functions panic if one of their properties is violated.

use takt_tests::fuzz::{feed, feed_files, words as split};

/// Inputs for each target.
const INPUTS: u64 = 10_000;

#[test]
fn net_text_stands_random_input() {
    let words = "{ } ( ) = , . [ ] 'true' '1' '2.5' '{1,2}' \\ # \n a b parent inValue inFirst inSecond inActive \
                 outValue outTerminate Value Key Core::Clock() Core::DoubleAdd Core::DoublePre Core::BooleanValue \
                 a=Core::Clock(), b=Core::DoubleAdd(inFirst=a.outValue), b=Core::DoubleAdd(inFirst[2.0]=a.outValue), \
                 Core::DoubleInterNetcommIn(RemoteNet='rpinet0') b.outValue";
    feed("net_text", takt_net::fuzz::net_text, &split(words), INPUTS);
}

#[test]
fn value_text_stands_random_input() {
    let words = "true false null 1 -2 0.5 1e308 1e-320 NaN inf { } , ; {1,2,3} {1,2,3,0,0,0} 9223372036854775807 ' \"";
    feed(
        "value_text",
        takt_net::fuzz::value_text,
        &split(words),
        INPUTS,
    );
}

#[test]
fn directio_stands_random_input() {
    let words = "a = ( ) , [ ] { } : ver nse nene nesc snc ok err \"2.0\" \" \\ 1 2147483648 1.5 a=ver(\"2.0\") \n \r\n {a:\"b\"} \
                 \u{1} \u{81}";
    feed("directio", takt_client::wire::fuzz, &split(words), INPUTS);
    feed("frames", takt_server::fuzz_frames, &split(words), INPUTS);
}

#[test]
fn net_xml_stands_random_input() {
    let words = "<rpinet> </rpinet> <module <fragment <parameter <inport <outport id='a' type='Core::Clock' name='inX' \
                 frommodule='a' fromport='outValue' debug='2' debug='x' value='1' > /> </module> </fragment> &lt; &#x0; &amp; \" \
                 <?xml?> <!-- --> <![CDATA[ ]]> parent ROOT";
    feed("net_xml", takt_net::fuzz::net_xml, &split(words), INPUTS);
}

#[test]
fn machine_files_stand_random_input() {
    let words = "component C { } property in out operation a b : double int bool string [ ] unit \"rad\" range 0 .. 1 default live \
                 doc done every ; , ( ) '$a' { a=Core::DoubleNetcommIn(Key='a',Value='$a') , outTerminate=a.outValue } \" ' # \n";
    feed(
        "machine_component",
        takt_machine::fuzz::component,
        &split(words),
        INPUTS,
    );
    let words = "<properties> </properties> <simple name='a' type='double' 'long' 'string' > <value> 1 </value> </simple> <struct \
                 </struct> <description> &#0; &lt; <![CDATA[ ]]> a = 1 \n [a] { } \"@type\" \"@value\" \"short\" [ 1.5 , ] nan inf 0x1F";
    feed(
        "machine_properties",
        takt_machine::fuzz::properties,
        &split(words),
        INPUTS,
    );
    let files: [&[u8]; 2] = [
        include_bytes!("../../rcc/machine/tests/properties/servo.cpf"),
        include_bytes!("../../rcc/machine/tests/properties/servo.toml"),
    ];
    feed_files(
        "machine_properties",
        takt_machine::fuzz::properties,
        &files,
        INPUTS,
    );
    let lola: &[u8] = include_bytes!("../../examples/machine/lola.machine");
    feed_files("machine", takt_machine::fuzz::machine, &[lola], INPUTS / 4);
    let words = "machine M { } initial final state A entry run handle exit transition to if on e component c from \"c\" ; configured \
                 event var n : int := + 1 ( ) start stop configure c c.flag c.level[1] while yield wait 5ms do call c.work(1) until \
                 within else not and or is running raise machine initial state A { transition to B; } final state B { } { start c; }";
    feed(
        "machine",
        takt_machine::fuzz::machine,
        &split(words),
        INPUTS / 4,
    );
    let servo: &[u8] = include_bytes!("../../rcc/machine/tests/components/servo.component");
    feed_files(
        "machine_component",
        takt_machine::fuzz::component,
        &[servo],
        INPUTS,
    );
}

#[test]
fn http_requests_stand_random_input() {
    let mut words = split(
        "GET POST PUT /nets/ //eval// /DirectIO/ /?token= %41 %ff ?format=json & = { } [ ] ' < >",
    );
    let lines: [&[u8]; 14] = [
        b" HTTP/1.1\r\n",
        b"\r\n",
        b"\r\n\r\n",
        b"GET / HTTP/1.1\r\n",
        b"POST /nets/ HTTP/1.1\r\n",
        b"Authorization: Bearer ",
        b"Cookie: a=b; takt_token=",
        b"0123456789abcdef",
        b"Content-Length: 3\r\n",
        b"Transfer-Encoding: chunked\r\n",
        b"Upgrade: websocket\r\nSec-WebSocket-Key: a\r\n",
        b"Origin: http://h:80\r\nHost: h:80\r\n",
        b"Expect: 100-continue\r\n",
        b"GET /?token=0123456789abcdef HTTP/1.1\r\n\r\n",
    ];
    words.extend(lines);
    feed("http", takt_server::fuzz_http_head, &words, INPUTS);
}

#[test]
fn scope_request_stands_random_input() {
    let mut words = split(
        "{ } [ ] : , \"a\" 0 1 -1 65 1e999 0.5 null true \"probes\": \"every\": \"trigger\": \"on\": \"rising\" \"level\": \
         \"mode\": \"single\" \"pre_s\": \"post_s\": \"rate_hz\":",
    );
    let requests: [&[u8]; 2] = [
        br#"{"probes":["a"],"rate_hz":30"#,
        br#"{"probes":["a"],"trigger":{"on":"inside","probe":"a","low":0,"high":1}"#,
    ];
    words.extend(requests);
    feed("scope", takt_server::fuzz_scope, &words, INPUTS);
}

#[test]
fn live_message_stands_random_input() {
    let mut words = split(
        "{ } [ ] : , \"a\" 0 1 -1 4294967296 1e999 null true \"op\": \"subscribe\" \"unsubscribe\" \"getParameters\" \
         \"setParameters\" \"subscriptions\": \"id\": \"channelId\": \"parameterNames\": \"parameters\": \"name\":",
    );
    let messages: [&[u8]; 4] = [
        br#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":2}]"#,
        br#"{"op":"getParameters","parameterNames":["a"],"id":"x""#,
        b"\x02\x01\0\0\0\x07\0\0\0\x04\0\0\0json",
        b"\x02\x01\0\0\0\x07\0\0\0\xff\xff\xff\xff",
    ];
    words.extend(messages);
    feed("live", takt_server::fuzz_live, &words, INPUTS);
}

#[test]
fn fri_stands_random_input() {
    // Datagrams have fixed lengths and headers: with valid ones of each kind, the rest is decoded.
    fn target(bytes: &[u8]) {
        use takt_fri::lwr::wire::{Cmd, Msr};
        takt_fri::lwr::wire::fuzz(bytes);
        let headers = [
            (Msr::LEN, [0x94, 0x03, 0x06, 0x20]),
            (Cmd::LEN, [0x78, 0x01, 0x05, 0x10]),
        ];
        for (length, header) in headers {
            let mut whole = bytes.to_vec();
            whole.resize(length, 0);
            whole[4..8].copy_from_slice(&header);
            takt_fri::lwr::wire::fuzz(&whole);
        }
    }
    let words: [&[u8]; 4] = [&[0; 4], &[1, 0], &[0, 0, 0xc0, 0x7f], &[0, 0, 0x80, 0x3f]];
    feed("fri", target, &words, INPUTS);
}

/// pcap and pcapng files with FRI datagrams, damaged.
#[test]
fn fri_recordings_stand_damage() {
    let files = takt_fri::capture::files();
    let files: Vec<&[u8]> = files.iter().map(Vec::as_slice).collect();
    feed_files("fri_files", takt_fri::capture::fuzz_file, &files, INPUTS);
}

/// pcap and pcapng files, damaged.
#[test]
fn captures_stand_damage() {
    let files: [&[u8]; 2] = [
        include_bytes!("../../can/tests/captures/made.pcap"),
        include_bytes!("../../can/tests/captures/made.pcapng"),
    ];
    for file in files {
        assert!(takt_link::capture::Reader::new(file).is_ok());
    }
    feed_files("capture", takt_link::capture::fuzz, &files, INPUTS);
}

/// MCAP files of a controller, damaged.
#[test]
fn recordings_of_a_controller_stand_damage() {
    let files = takt_core::record::files();
    let files: Vec<&[u8]> = files.iter().map(Vec::as_slice).collect();
    feed_files("mcap", takt_core::record::fuzz, &files, INPUTS);
}
