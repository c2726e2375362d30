// SPDX-License-Identifier: Apache-2.0
/// tests/io/avatar_version_1.hpp: an avatar file of version 1, as the last program that wrote
/// such files wrote it: half precision, visual axes, two points each of face and eyes.
#pragma once

#include <string_view>

#include <rye/io/gzip.hpp>

namespace rye::test {

/// The file, compressed by gzip, in base64.
inline constexpr std::string_view avatar_version_1_text =
    "H4sIAAAAAAACA7WZwW7bRhCG2T5Bjz30YPDUw1Ygl+RyFaCNTgX6DFZArKmVrZoiFZJy4gRBfeiD+AF6CIKkyaW2HqGP"
    "kN56zCN0hqQlilyJK8oVYK04u/z+2Znhckn/+51RfF6bQTCXuZiIXASB+eS1GV7I8DJbzs0nJqfCCZl9ZhJTvlykMstm"
    "SRzEYi4z6D0dm7+KF2PzGXRPk3QucjCm1/IHcQWwFKzn4pUMxMsZjr6aZUsRgTGS0zyQ1zJYJLM4xy4brAjFUTJFjRM0"
    "ZTLPZ/E5jng9rjkwNp/YZGxOpciXqayOwgsRxzLK4NDBzlQ+X8o4nEm0WGBZJJkM2ubCxbYZ1IJYihQPB7ZXWaaVgXoP"
    "Z67HWP7a9jDKLoZBcNNZCIaxmT1filROxiaYJxJDFmShiGQxGr0WOYw9W+ayZqeVdphECXJP7WcPs9k24aCSuj2qYcNh"
    "a51se6jCXsyogShsDXHIZzKdQsrWpuUiE/NFJNMgFAsRzvLrKlWbjkmyPIswxVXUNz1xqTc24ySWRcA2fdnlbAF9ebqU"
    "b6BMqpIp6ugNMc9EeHmeJst4gsU8ya8XWFc/Mxcr6kLg0alDwEOzKPnSaaixU4tQ9xkAQqjEVAwiGWe7CTbx2wTqEm7V"
    "EGmSi7xwbbcjThvDLWJ7tMbJUxFnUQfKVqGAQ2yfIetSLBZi9+mUUMXpPiPU4nh6LJfgRjTYXIb7XFGEFziE2qzOwjra"
    "55FiQkAglLl1ClbuPl+YgsJc4ti0TikuuAOnBAji0CLjkKFzqRkcRaCBQhyHbUhdoXEVDIcR1yq9SSKZ7fDml21v2hxg"
    "AIdvOA8L9oEUTtwy3SUlnZ1f9MBAvt3yuizvKgMgZINQxnm6HSCHdtUOcIjr8ibr5fWrQ0EuzM2nNdBUhHIQiXgyF+ll"
    "FjiToKqr3WTlpQ9U4lm8ST7cRYAQz6HNuW6W6WAeLQZhEl9Zg7OZ2F7pbNZV+YAGvKuFfyEx87sFfLWAS7x2rhQCdqf/"
    "igUA0MRjlha+y3+uFGAWYR5rClR7lt0wZTIBRBhrBSMp76r7YIrIAogwv1UZyntVg6ZYdIBEGG+5Vqym2aHT5Jz4ltUs"
    "/u0Ny3F1C3iQoNoSXbmnahEKIkxTpLt+uUqCEZ9SbYmueThKEQrz8JX5KDZ/R6bCh1T4VIfeLws+es+6+d0JcFR0SACn"
    "OvTu2Kv4nMJeUhn76snhqOADGvBUC9/lv6sWAP9tHf97hR/QgGda+C7/PbUAI9xtCWis36pguADzWsHAfdXmUerIhHoQ"
    "EI9qS3QXpVIEkupxTZF+ifU44czVluguTpUIbP853z2PR7nC4GbGh5a+RneZqlSGFhla2iq9UgJ80GD6Gl0zYWoVRoZu"
    "q4D77XEABLCWy413HMclGPigwfU1eu2DQYEMGdVV6bWZAD4Z+lxfo3tHrFLxObFtS52UR1gBkY0CXEugVzKQDhKUakj0"
    "utSQjQJcS6A7DWoJnIOvzsNjrHwIRwWup9A1i+EODZzFUGsWPVMxhFlQi+opdM0C9isqEeCDSPv6Ll6WPNbeAAVQxdVX"
    "6bU9QAnQaT8x7NLplxgQQBWmr9Jrk4ASxHasPbN5lKsFFFCGHiDTa6uAGiBk6wv1Sw++FIUvfoBMrw0DaoCQ167qfm8y"
    "EAW8dvX2epeBIKBtPSGu/4MxmMXhoPjfB9ZqfDXQeMRV35BAgNiuw7RUnJ5rLfBBZCvQG5FkmYdFGnsVi4sxd7dexKnQ"
    "naurGs4shENw3pyclP/t/PJU0d5e/eaPai18Tqr226q1qvZ7bEf/vPq9wTFuDOXny/2B/VX7TaX3tupfVTq3Vbu6N/Z+"
    "1n5p2rs+63jdbx//fd9onzbajn7D+Kpqv15rjX6C+d1BKH6EAzjv5i84Btvnu7L/M/w24PcttDc7bE1GnTNCO7S3dwY1"
    "LOMj9PrGW8Mz3ht/GsT4ZPxhMOPd1m/X+NAYSY/ur/fgX+OMzytjNbobrVZ3Nyvox5HHKpaUckz7XL9xxn4qfn+qesvv"
    "Xbrva0clSSd2aNmXHTzr/85QV7/f6CmPDqV/UIwuxx/j77vqV/m9a/THGqu06+g17es6Hd0/WpzLnmLUfwjD2ZiqIgAA";

/// The file's bytes.
inline Bytes avatar_version_1() {
    const auto digit = [](char c) -> unsigned {
        if (c >= 'A' && c <= 'Z') return static_cast<unsigned>(c - 'A');
        if (c >= 'a' && c <= 'z') return static_cast<unsigned>(c - 'a') + 26;
        if (c >= '0' && c <= '9') return static_cast<unsigned>(c - '0') + 52;
        return c == '+' ? 62 : 63;
    };
    Bytes packed;
    unsigned bits = 0;
    int held = 0;
    for (const char c : avatar_version_1_text) {
        if (c == '=') break;
        bits = bits << 6 | digit(c);
        held += 6;
        if (held < 8) continue;
        held -= 8;
        packed.push_back(static_cast<std::byte>(bits >> held & 255U));
    }
    return gunzip(packed, "version 1");
}

} // namespace rye::test
